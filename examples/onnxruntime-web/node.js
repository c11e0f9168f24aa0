// Answers samples from stdin in Node, as examples/onnxruntime-c does: node node.js MODEL < samples.txt
import { readFileSync } from "node:fs";
import * as ort from "onnxruntime-web";
import { openHand, readSamples } from "./hand.js";

const answer = await openHand(ort, readFileSync(process.argv[2]));
const { labels, step_us } = await answer(readSamples(readFileSync(0, "utf8")));
console.log(labels.join("\n"));
console.error(step_us);
