// Answers a stream as rows.c does, in WebAssembly: node rows.mjs HAND.wasm FILE PASSES
import { readFileSync, writeSync } from "node:fs";

const [wasm, file, passes] = process.argv.slice(2);
const { instance } = await WebAssembly.instantiate(readFileSync(wasm), {});
const hand = instance.exports;
const memory = new Uint8Array(hand.memory.buffer);
const lanes = 8 * hand.channels();
const sensors = hand.channels() / 3;
const rows = readFileSync(file);
const n = rows.length / (lanes + sensors);

function answer(keep) {
  hand.begin();
  for (let k = 0, at = 0; k < n; ++k, at += lanes + sensors) {
    memory.set(rows.subarray(at, at + lanes), hand.samples());
    memory.set(rows.subarray(at + lanes, at + lanes + sensors), hand.valids());
    if (hand.step() !== 0) throw new Error(`row ${k} was refused`);
    if (keep) keep();
  }
}

const kept = [];
answer(() => {
  kept.push(Buffer.from(Int32Array.of(hand.label()).buffer));
  for (const [place, bytes] of [
    [hand.answers(), hand.answers_bytes()],
    [hand.states(), hand.states_bytes()],
  ]) kept.push(Buffer.from(memory.slice(place, place + bytes)));
});
const times = [];
for (let pass = 0; pass < Number(passes); ++pass) {
  const begin = performance.now();
  answer(null);
  times.push((1e3 * (performance.now() - begin)) / n);
}
const all = Buffer.concat(kept);
for (let at = 0; at < all.length; ) at += writeSync(1, all, at);
times.sort((one, other) => one - other);
process.stderr.write(`${times[times.length >> 1].toFixed(4)}\n`);
