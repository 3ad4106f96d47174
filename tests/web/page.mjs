// The script of native.c by the page's wasm: node tests/web/page.mjs PAGE.wasm
import { readFile } from "node:fs/promises";

const wasi = new Proxy({}, { get: () => () => 0 });
const { instance } = await WebAssembly.instantiate(await readFile(process.argv[2]), { wasi_snapshot_preview1: wasi });
const page = instance.exports;
const text = () => {
    const bytes = new Uint8Array(page.memory.buffer, page.page_message());
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
};
let spent = [];
function frames(count) {
    for (let i = 0; i < count; i++) {
        const begun = performance.now();
        if (!page.page_step(1 / 60)) console.log("frame: " + text());
        spent.push(performance.now() - begun);
    }
}
// As C's %.9g writes numbers of this size.
const digits = (x) => Number(x.toPrecision(9)).toString();

page._initialize();
if (!page.page_make(10)) throw new Error(text());
frames(5);
for (let tool = 0; tool < 4; tool++) {
    let most = 0;
    if (!page.page_press(tool, 0.01, 0.005, 0.3, 0, 0, -1)) throw new Error(text());
    for (let i = 0; i < 40; i++) {
        page.page_move(0.01 + (tool === 3 ? 0 : 0.001 * i), 0.005 + (tool === 2 ? 0.002 * i : 0), 0.3, 0, 0, -1);
        frames(1);
        most = Math.max(most, page.page_force());
    }
    page.page_release();
    frames(10);
    const hash = (page.page_hash() >>> 0).toString(16).padStart(8, "0");
    console.log(`${tool} ${hash} ${page.page_vertex_count()} ${digits(most)}`);
}
page.page_make(17);
spent = [];
frames(60);
spent.sort((a, b) => a - b);
console.error(`${page.page_element_count()} tets: median frame ${spent[30].toFixed(2)} ms in node`);
