//! Answers prepared samples from stdin, 18 numbers a line, nan for a lost finger. Prints the situation
//! of each, -1 for unknown; at the end, to stderr, microseconds a step.
use ort::{session::Session, value::Tensor};
use std::io::{stdin, BufRead};
use std::time::{Duration, Instant};

const CHANNELS: usize = 18;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    std::env::set_var("ORT_DISABLE_TELEMETRY", "1");
    let mut args = std::env::args().skip(1);
    ort::init_from(args.next().ok_or("hand LIBRARY MODEL")?)
        .with_telemetry(false)
        .commit()?;
    let model = args.next().ok_or("hand LIBRARY MODEL")?;
    let mut session = Session::builder()?
        .with_intra_threads(1)?
        .commit_from_file(model)?;
    let table = session.inputs.iter().find(|input| input.name == "state");
    let shape = table.and_then(|input| input.input_type.tensor_shape());
    let rows_of_state = shape.ok_or("no state in this file")?[1] as usize;
    let (mut state, mut reset) = (vec![0.0f64; rows_of_state * CHANNELS], true);
    let (mut rows, mut spent) = (0, Duration::ZERO);
    for line in stdin().lock().lines() {
        let sample: Vec<f64> = line?
            .split_whitespace()
            .map(|word| word.parse().unwrap_or(f64::NAN))
            .collect();
        if sample.len() != CHANNELS {
            return Err(format!("{} numbers, not {CHANNELS}", sample.len()).into());
        }
        let begin = Instant::now();
        let out = session.run(ort::inputs![
            "sample" => Tensor::from_array(([1, 1, CHANNELS], sample))?,
            "valid" => Tensor::from_array(([1, 1, CHANNELS / 3], vec![true; CHANNELS / 3]))?,
            "reset" => Tensor::from_array(([1, 1, 1], vec![reset]))?,
            "state" => Tensor::from_array(([1, rows_of_state, CHANNELS], state))?,
        ])?;
        spent += begin.elapsed();
        rows += 1;
        let unknown = out["unknown"].try_extract_tensor::<bool>()?.1[0];
        let situation = out["situation"].try_extract_tensor::<i64>()?.1[0];
        println!("{}", if unknown { -1 } else { situation });
        state = out["state_out"].try_extract_tensor::<f64>()?.1.to_vec();
        reset = false;
    }
    eprintln!("{:.4}", spent.as_secs_f64() * 1e6 / f64::from(rows.max(1)));
    Ok(())
}
