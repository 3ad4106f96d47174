// The page in a headless Chromium: node tests/web/browser.mjs CHROMIUM PAGE.html PICTURE.png
// Waits for frames, uses every tool with the mouse, and looks whether an organ is in the picture.
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";

const [chromium, page, picture] = process.argv.slice(2);
const profile = mkdtempSync(join(tmpdir(), "page-"));
const flags = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"];
flags.push("--window-size=900,600", "--remote-debugging-pipe", "--user-data-dir=" + profile, "about:blank");
const browser = spawn(chromium, flags, { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
const answers = new Map();
let rest = "", number = 0;
browser.stdio[4].on("data", (bytes) => {
    const messages = (rest + bytes).split("\0");
    rest = messages.pop();
    for (const message of messages.map((m) => JSON.parse(m))) answers.get(message.id)?.(message);
});
let sessionId;
const call = (method, params = {}) =>
    new Promise((done, failed) => {
        answers.set(++number, (m) => (m.error ? failed(new Error(m.error.message)) : done(m.result)));
        browser.stdio[3].write(JSON.stringify({ id: number, method, params, sessionId }) + "\0");
    });
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const evaluate = async (expression) => (await call("Runtime.evaluate", { expression, returnByValue: true })).result.value;
const frames = async () => Number((await evaluate("document.title")).match(/(\d+) frames/)?.[1] ?? 0);
async function until(count) {
    for (const begun = Date.now(); (await frames()) < count; await wait(100))
        if (Date.now() - begun > 120000) throw new Error(`${await frames()} frames: ${await evaluate("document.body.innerText")}`);
}
const mouse = (type, x, y) => call("Input.dispatchMouseEvent", { type, x, y, button: "left", buttons: 1, clickCount: 1 });

async function run() {
    const { targetId } = await call("Target.createTarget", { url: "file://" + resolve(page) + "?cells=8" });
    ({ sessionId } = await call("Target.attachToTarget", { targetId, flatten: true }));
    await until(20);
    for (let tool = 0; tool < 4; tool++) {
        const before = await frames();
        await evaluate(`document.querySelector("[data-tool='${tool}']").click()`);
        await mouse("mousePressed", 500, 290);
        await wait(300);
        if (!(await evaluate("held"))) throw new Error(`tool ${tool} holds nothing: ${await evaluate("$('says').textContent")}`);
        for (let i = 1; i <= 8; i++) {
            await mouse("mouseMoved", 500 + 8 * i, 290 + 4 * i);
            await wait(60);
        }
        await until(before + 15);
        if (tool === 2) {
            const { data } = await call("Page.captureScreenshot");
            writeFileSync(picture, Buffer.from(data, "base64"));
        }
        await mouse("mouseReleased", 564, 322);
        await wait(200);
        console.log(`tool ${tool}: ${(await evaluate("$('figures').textContent")).replaceAll("\n", "; ")}`);
    }
    // Share of the picture that is not background.
    const share = await evaluate(`(() => { draw(); const w = canvas.width, h = canvas.height, all = new Uint8Array(4 * w * h);
        gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, all);
        let lit = 0; for (let i = 0; i < all.length; i += 4) lit += all[i] > 45; return lit / (w * h); })()`);
    if (!(share > 0.03 && share < 0.8)) throw new Error(`${(100 * share).toFixed(1)} % of the picture is organ`);
    const complaints = await evaluate("$('says').textContent");
    if (complaints) throw new Error(complaints);
    console.log(`${await evaluate("document.title")}; ${(100 * share).toFixed(0)} % of the picture is organ`);
}
let status = 0;
try {
    await run();
} catch (error) {
    console.log("FAILED: " + error.message);
    status = 1;
}
browser.kill("SIGKILL");
await wait(300);
rmSync(profile, { recursive: true, force: true, maxRetries: 5 });
process.exit(status);
