// Runs a WASI program under node with the working folder, ../shared and a folder for temporary files open to it:
//     node tests/wasi.mjs PROGRAM [ARGUMENT...]
import { readFile } from "node:fs/promises";
import { existsSync } from "node:fs";
import { tmpdir } from "node:os";
import { WASI } from "node:wasi";

const shared = process.env.SHARED || "../shared";
const preopens = { ".": ".", "/tmp": tmpdir() };
if (existsSync(shared)) preopens[shared] = shared;
const wasi = new WASI({
    version: "preview1",
    args: process.argv.slice(2),
    env: process.env.SHARED ? { SHARED: shared } : {},
    preopens,
    returnOnExit: true,
});
const module = await WebAssembly.compile(await readFile(process.argv[2]));
const instance = await WebAssembly.instantiate(module, { wasi_snapshot_preview1: wasi.wasiImport });
process.exit(wasi.start(instance));
