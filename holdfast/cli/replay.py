"""`holdfast replay MODEL SOURCE`: the model's answers on a recording, one JSON line a sample."""

from __future__ import annotations

import argparse
import sys

from holdfast.cli.options import set_reader


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument("model", metavar="MODEL", help="a sealed holdfast.onnx")
    parser.add_argument(
        "trial",
        metavar="TRIAL",
        help="a trial's CSV or folder, SET#N, or sim://CARD?trial=N",
    )


def run(args: argparse.Namespace) -> int:
    """Replay the whole trial to stdout."""
    from holdfast.core.contract import not_learned_in_words
    from holdfast.edge_runtime.monitor import GripMonitor, Model, require_fit
    from holdfast.live.outputs import to_json_line
    from holdfast.live.running import say
    from holdfast.live.sources import open_source

    model = Model(args.model)
    card = model.card
    source = open_source(
        args.trial,
        channels=card.n_channels,
        read_set=set_reader(args.trial),
    )
    source = source.at_rate(card.rate_hz, say).prepared(card.preparation)
    # Before the first answer, so that stdout holds either answers of this trial or nothing.
    require_fit(
        card,
        n_channels=source.values.shape[1],
        unit=source.unit,
        rate_hz=source.rate_hz,
        where=args.trial,
    )
    # Without a clock: an answer of a replay is never late.
    monitor = GripMonitor(model, None, bias_known=source.zero == "measured")
    not_learned = card.not_learned
    for line in not_learned_in_words(not_learned):
        sys.stderr.write(f"{line}\n")
    for sample in source:
        sys.stdout.write(to_json_line(monitor.feed(sample), not_learned) + "\n")
    return 0
