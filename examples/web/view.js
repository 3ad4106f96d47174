// The page: draws what the simulation's thread posts, and tells it of the pointer.
"use strict";

const $ = (id) => document.getElementById(id);
const cells = Number(new URLSearchParams(location.search).get("cells")) || 14; // some 9,000 tets
const canvas = $("view");
const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
const says = (text) => ($("says").textContent = text);

// ---- the camera looks at the origin, z is up ----
const camera = { turn: -0.9, rise: 0.75, distance: 0.33, field: 0.7 };
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
function frameOf() {
    const { turn, rise, distance } = camera;
    const back = [Math.cos(rise) * Math.cos(turn), Math.cos(rise) * Math.sin(turn), Math.sin(rise)];
    const right = [-Math.sin(turn), Math.cos(turn), 0];
    return { eye: back.map((x) => x * distance), back, right, up: cross(back, right) };
}
function matrix() {
    const { eye, back, right, up } = frameOf();
    const f = 1 / Math.tan(camera.field / 2), aspect = canvas.width / canvas.height, near = 0.02, far = 4;
    const dot = (a) => -(a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2]);
    const rows = [[...right, dot(right)], [...up, dot(up)], [...back, dot(back)]];
    const scale = [f / aspect, f], depth = -(far + near) / (far - near);
    const m = new Float32Array(16);
    for (let j = 0; j < 4; j++) {
        m[4 * j] = scale[0] * rows[0][j];
        m[4 * j + 1] = scale[1] * rows[1][j];
        m[4 * j + 2] = depth * rows[2][j] + (j === 3 ? (-2 * far * near) / (far - near) : 0);
        m[4 * j + 3] = -rows[2][j];
    }
    return m;
}
// The ray through a point of the canvas: origin and direction.
function ray(x, y) {
    const { eye, back, right, up } = frameOf();
    const t = Math.tan(camera.field / 2), aspect = canvas.clientWidth / canvas.clientHeight;
    const a = ((2 * x) / canvas.clientWidth - 1) * t * aspect, b = (1 - (2 * y) / canvas.clientHeight) * t;
    const d = [0, 1, 2].map((i) => right[i] * a + up[i] * b - back[i]);
    const length = Math.hypot(...d);
    return [...eye, ...d.map((c) => c / length)];
}

// ---- WebGL ----
function program(vertex, fragment) {
    const p = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + source);
        gl.compileShader(shader);
        gl.attachShader(p, shader);
    }
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
    return p;
}
let tissue, plain, vertexBuffer, indexBuffer, plainBuffer;
function prepare() {
    tissue = program(
        `layout(location = 0) in vec3 place; layout(location = 1) in vec3 normal; layout(location = 2) in vec2 more;
         uniform mat4 m; out vec3 n; out vec3 p; out vec2 data;
         void main() { n = normal; p = place; data = more; gl_Position = m * vec4(place, 1.0); }`,
        `in vec3 n; in vec3 p; in vec2 data; uniform vec3 eye; uniform float most; uniform float colours; out vec4 colour;
         vec3 ramp(float t) { return clamp(vec3(1.6 * t - 0.2, 1.5 - abs(2.4 * t - 1.2), 1.2 - 1.9 * t), 0.05, 0.95); }
         void main() {
             vec3 base = mix(vec3(0.62, 0.24, 0.20), vec3(0.80, 0.36, 0.30), data.y);
             float t = clamp(data.x / most, 0.0, 1.0);
             base = mix(base, ramp(t), colours * 0.8 * smoothstep(0.02, 0.3, t)); // tissue where there is little
             vec3 normal = normalize(n), look = normalize(eye - p), sun = normalize(vec3(0.4, -0.3, 0.9));
             float light = 0.32 + 0.6 * max(dot(normal, sun), 0.0) + 0.2 * max(dot(normal, look), 0.0);
             float shine = 0.35 * pow(max(dot(reflect(-sun, normal), look), 0.0), 40.0);
             colour = vec4(base * light + shine, 1.0); }`,
    );
    plain = program(
        `layout(location = 0) in vec3 place; uniform mat4 m; void main() { gl_Position = m * vec4(place, 1.0); }`,
        `uniform vec3 paint; out vec4 colour; void main() { colour = vec4(paint, 1.0); }`,
    );
    vertexBuffer = gl.createBuffer();
    indexBuffer = gl.createBuffer();
    plainBuffer = gl.createBuffer();
    gl.enable(gl.DEPTH_TEST);
}
function drawTissue(frame, m) {
    gl.useProgram(tissue);
    gl.uniformMatrix4fv(gl.getUniformLocation(tissue, "m"), false, m);
    gl.uniform3fv(gl.getUniformLocation(tissue, "eye"), frameOf().eye);
    gl.uniform1f(gl.getUniformLocation(tissue, "most"), 0.25 * young());
    gl.uniform1f(gl.getUniformLocation(tissue, "colours"), $("stress").checked ? 1 : 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, vertexBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, frame.vertices, gl.DYNAMIC_DRAW);
    [[0, 3, 0], [1, 3, 12], [2, 2, 24]].forEach(([at, size, offset]) => {
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, gl.FLOAT, false, 32, offset);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indexBuffer);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, frame.triangles, gl.DYNAMIC_DRAW);
    gl.drawElements(gl.TRIANGLES, frame.triangles.length, gl.UNSIGNED_INT, 0);
    gl.disableVertexAttribArray(1);
    gl.disableVertexAttribArray(2);
}
function drawPlain(points, mode, paint, m) {
    gl.useProgram(plain);
    gl.uniformMatrix4fv(gl.getUniformLocation(plain, "m"), false, m);
    gl.uniform3fv(gl.getUniformLocation(plain, "paint"), paint);
    gl.bindBuffer(gl.ARRAY_BUFFER, plainBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.drawArrays(mode, 0, points.length / 3);
}
// A tube of 1.6 mm along the needle's line, and a ball for the probe: strips of triangles.
function tube(line, radius) {
    const out = [];
    for (let i = 3; i + 2 < line.length; i += 3) {
        const a = line.slice(i - 3, i), b = line.slice(i, i + 3), d = [0, 1, 2].map((k) => b[k] - a[k]);
        const side = cross(d, Math.abs(d[2]) < Math.hypot(...d) * 0.9 ? [0, 0, 1] : [1, 0, 0]), other = cross(d, side);
        for (let s = 0; s <= 8; s++) {
            const angle = (s * Math.PI) / 4;
            for (const end of [a, b])
                for (let k = 0; k < 3; k++)
                    out.push(end[k] + (radius * Math.cos(angle) * side[k]) / Math.hypot(...side) + (radius * Math.sin(angle) * other[k]) / Math.hypot(...other));
        }
    }
    return new Float32Array(out);
}
function ball([x, y, z, r]) {
    const out = [];
    for (let i = 0; i < 12; i++)
        for (let j = 0; j <= 24; j++)
            for (const k of [i, i + 1]) {
                const a = (k * Math.PI) / 12, b = (j * Math.PI) / 12;
                out.push(x + r * Math.sin(a) * Math.cos(b), y + r * Math.sin(a) * Math.sin(b), z + r * Math.cos(a));
            }
    return new Float32Array(out);
}
let latest = null;
function draw() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.08, 0.095, 0.115, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const m = matrix();
    drawTissue(latest, m);
    if (latest.probe[3] > 0) drawPlain(ball(latest.probe), gl.TRIANGLE_STRIP, [0.75, 0.78, 0.82], m);
    if (latest.line.length > 3) drawPlain(tube(latest.line, 0.0008), gl.TRIANGLE_STRIP, [0.85, 0.87, 0.9], m);
}

// ---- the simulation ----
const young = () => 10 ** Number($("young").value);
const source = new Blob([$("worker").textContent], { type: "text/javascript" });
const worker = new Worker(URL.createObjectURL(source));
const bytes = Uint8Array.from(atob($("wasm").textContent), (c) => c.charCodeAt(0));
const spent = [];
let frames = 0, begun = performance.now();
function figures(frame) {
    spent.push(frame.ms);
    if (spent.length > 60) spent.shift();
    const sorted = [...spent].sort((a, b) => a - b), median = sorted[sorted.length >> 1];
    const rate = (1000 * frames) / (performance.now() - begun);
    $("figures").textContent =
        `${frame.elements} tets, ${frame.triangles.length / 3} triangles\n` +
        `step ${median.toFixed(1)} ms, ${rate.toFixed(0)} per second\nforce ${frame.force.toFixed(2)} N`;
    document.title = `softbody: ${frames} frames, ${median.toFixed(2)} ms`;
}
worker.onmessage = ({ data }) => {
    if (data.dead) return says(data.dead);
    if ("pressed" in data) {
        held = data.pressed === 1;
        return says(data.message);
    }
    latest = data;
    frames++;
    if (data.message) says(data.message);
    requestAnimationFrame(() => {
        draw();
        figures(data);
        worker.postMessage({ drawn: 1 });
    });
};
worker.onerror = (error) => says(error.message);

// ---- the pointer: one finger or the left button works, two fingers or another button turn, a pinch or the wheel zooms ----
let tool = 0, held = false;
const pointers = new Map();
let spread = 0;
const middle = () => {
    const all = [...pointers.values()];
    return [0, 1].map((k) => all.reduce((sum, p) => sum + p[k], 0) / all.length);
};
const span = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
};
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size > 1) {
        worker.postMessage({ release: 1 });
        held = false;
        spread = span();
    } else if (event.button === 0) worker.postMessage({ press: ray(event.clientX, event.clientY), tool });
});
canvas.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) return;
    const before = middle();
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (held) return worker.postMessage({ move: ray(event.clientX, event.clientY) });
    const now = middle();
    camera.turn -= (now[0] - before[0]) * 0.008;
    camera.rise = Math.min(1.5, Math.max(-1.5, camera.rise + (now[1] - before[1]) * 0.008));
    if (pointers.size > 1) {
        camera.distance *= spread / span();
        spread = span();
    }
});
const lifted = (event) => {
    pointers.delete(event.pointerId);
    if (held) worker.postMessage({ release: 1 });
    held = false;
};
canvas.addEventListener("pointerup", lifted);
canvas.addEventListener("pointercancel", lifted);
canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.distance = Math.min(1.5, Math.max(0.15, camera.distance * 1.001 ** event.deltaY));
}, { passive: false });
for (const button of document.querySelectorAll("[data-tool]"))
    button.onclick = () => {
        tool = Number(button.dataset.tool);
        for (const other of document.querySelectorAll("[data-tool]")) other.setAttribute("aria-pressed", String(other === button));
    };
function set() {
    $("young-out").textContent = `${(young() / 1000).toFixed(1)} kPa`;
    $("poisson-out").textContent = $("poisson").value;
    $("gravity-out").textContent = `${$("gravity").value} m/s²`;
    worker.postMessage({ set: [young(), Number($("poisson").value), Number($("gravity").value)] });
}
for (const id of ["young", "poisson", "gravity"]) $(id).oninput = set;
$("again").onclick = () => {
    worker.postMessage({ again: cells });
    set();
};

if (!gl) says("This browser has no WebGL 2.");
else {
    prepare();
    worker.postMessage({ wasm: bytes.buffer, cells }, [bytes.buffer]);
    set();
}
