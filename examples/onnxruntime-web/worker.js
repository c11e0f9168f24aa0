// The model in a worker: opening it takes seconds, in which the page stays alive.
// In: {model: bytes}, then {samples: text} any number of times. Out: {opened_s}, {labels, step_us} or {problem}.
import * as ort from "./node_modules/onnxruntime-web/dist/ort.wasm.bundle.min.mjs";
import { openHand, readSamples } from "./hand.js";

let answer;
let last = Promise.resolve(); // one message after another: a step must end before the next begins

async function open(model) {
  const begin = performance.now();
  answer = await openHand(ort, model);
  return { opened_s: (performance.now() - begin) / 1000 };
}

onmessage = ({ data: { model, samples } }) => {
  last = last
    .then(() => (model ? open(model) : answer(readSamples(samples))))
    .then(postMessage, (error) => postMessage({ problem: error.message }));
};
