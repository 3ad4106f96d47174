// The simulation's thread: runs page.c as wasm, steps it 60 times a second and posts what is to be drawn.
"use strict";

let api, memory;
const text = (at) => {
    const bytes = new Uint8Array(memory.buffer, at);
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
};

// What a reactor of WASI asks for. Nothing is read or written here.
const wasi = new Proxy({}, { get: () => () => 0 });

async function load(bytes) {
    const { instance } = await WebAssembly.instantiate(bytes, { wasi_snapshot_preview1: wasi });
    api = instance.exports;
    memory = api.memory;
    api._initialize();
}

const floats = (at, count) => new Float32Array(memory.buffer, at, count).slice();

function frame(dt) {
    const begun = performance.now();
    const fine = api.page_step(dt);
    const ms = performance.now() - begun;
    const triangles = new Uint32Array(memory.buffer, api.page_triangles(), 3 * api.page_triangle_count()).slice();
    return {
        fine,
        ms,
        message: fine ? "" : text(api.page_message()),
        vertices: floats(api.page_vertices(), 8 * api.page_vertex_count()),
        triangles,
        line: floats(api.page_line(), 3 * api.page_line_count()),
        probe: [0, 1, 2, 3].map((i) => api.page_probe(i)),
        force: api.page_force(),
        elements: api.page_element_count(),
    };
}

let settings = null; // may be asked for before the organ is there
let waiting = 0; // frames that the page has not drawn yet
let last = 0;
function run() {
    const now = performance.now();
    if (waiting < 2) {
        const what = frame(1 / 60);
        waiting++;
        postMessage(what, [what.vertices.buffer, what.triangles.buffer, what.line.buffer]);
    }
    last = Math.max(last + 1000 / 60, now - 50);
    setTimeout(run, Math.max(0, last - performance.now()));
}

onmessage = async ({ data }) => {
    if (data.set) settings = data.set;
    if (data.wasm) {
        await load(data.wasm);
        if (!api.page_make(data.cells)) {
            postMessage({ dead: text(api.page_message()) });
            return;
        }
        if (settings) api.page_set(...settings);
        last = performance.now();
        run();
    } else if (!api) return;
    else if (data.drawn) waiting--;
    else if (data.press) postMessage({ pressed: api.page_press(data.tool, ...data.press), message: text(api.page_message()) });
    else if (data.move) api.page_move(...data.move);
    else if (data.release) api.page_release();
    else if (data.set) api.page_set(...data.set);
    else if (data.again) api.page_make(data.again);
};
