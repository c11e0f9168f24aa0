/** A hand in a sealed ONNX file. ort: onnxruntime-web; model: the file's bytes.
 *  -> answer(rows): samples without bias, NaN for a lost finger -> {labels, step_us}: of each sample the
 *  situation 0 to 3, or -1 for unknown. */
export async function openHand(ort, model) {
  ort.env.wasm.numThreads = 1; // one sample is too little for more
  const session = await ort.InferenceSession.create(model, { executionProviders: ["wasm"] });
  const shapes = Object.fromEntries(session.inputMetadata.map((one) => [one.name, [1, ...one.shape.slice(1)]]));
  const [, lanes, channels] = shapes.state;
  const valid = new ort.Tensor("bool", new Uint8Array(channels / 3).fill(1), shapes.valid);
  return async (rows) => {
    let state = new ort.Tensor("float64", new Float64Array(lanes * channels), shapes.state);
    const labels = [];
    const begin = performance.now();
    for (const [k, row] of rows.entries()) {
      if (row.length !== channels) throw new Error(`line ${k + 1} has ${row.length} numbers, not ${channels}`);
      const sample = new ort.Tensor("float64", Float64Array.from(row), shapes.sample);
      const reset = new ort.Tensor("bool", Uint8Array.of(k === 0), shapes.reset);
      const out = await session.run({ sample, valid, reset, state }, ["situation", "unknown", "state_out"]);
      state = out.state_out;
      labels.push(out.unknown.data[0] ? -1 : Number(out.situation.data[0]));
    }
    return { labels, step_us: (1000 * (performance.now() - begin)) / rows.length };
  };
}

/** Lines of numbers -> rows; NaN for what is no number. */
export function readSamples(text) {
  return text.trim().split("\n").map((line) => line.trim().split(/\s+/).map(Number));
}
