"""`python -m studies NAME`: one study by its name; without a name, what there is."""

from __future__ import annotations

import sys

from tools.harness import Program, start

PROGRAMS = {
    "real": Program(
        "studies.real.study",
        "train, export and evaluate on the public recordings, people held out",
        "build/real",
    ),
    "real-more": Program(
        "studies.real.further_rows",
        "the same with all 48 channels, and by a truer label",
        "build/real",
    ),
    "learners": Program(
        "studies.real.learners",
        "forest, network and committee on the public recordings; over an hour",
        "build/real",
    ),
    "nested-choice": Program(
        "studies.real.nested_choice",
        "taxels, features and learner chosen on people, never on those that are scored",
        "build/real",
    ),
    "window-network": Program(
        "studies.real.window_network",
        "a small convolutional network beside the committee on the public recordings",
        "build/real",
    ),
    "evaluate": Program(
        "studies.default_model",
        "the default model on unseen simulated sets, with baselines",
        "build/evaluate",
    ),
    "loop": Program(
        "studies.shared_control.program",
        "what holding on costs: grip controllers in a closed loop",
        "build/loop",
    ),
    "distortions": Program(
        "studies.distortions.program",
        "the same trials with one nuisance at a time: hand turned, noise, dead fingers",
        "build/distortions",
    ),
    "robustness": Program(
        "studies.robustness",
        "what pooled features and disturbed copies bring and cost, family by family",
        "build/robustness",
    ),
    "hands": Program(
        "studies.other_hands",
        "one learner on hands of 2, 3, 6 and 12 sensors, not trained again",
        "build/hands",
    ),
    "wide": Program(
        "studies.wide_scene",
        "the widest scene: its draws, and the shipped model on it by action",
        "build/wide",
    ),
    "scenes": Program(
        "studies.scenes.program",
        "thesis, apple, p1 and p2 at 50, 100 and 150 Hz",
        "build/scenes",
    ),
    "fast-handover": Program(
        "studies.fast_handover.study",
        "what tells a fast hand-over from a pull, one change at a time",
        "build/fast-handover",
    ),
    "learner-streams": Program(
        "studies.learner_streams",
        "learners on streams and on styles left out",
        "build/learner-streams",
    ),
    "adapt": Program(
        "studies.adapt.program",
        "what adapting to a person brings, simulated and on people",
        "build/adapt-study",
    ),
    "transfer": Program(
        "studies.transfer.program",
        "what the simulation is worth: scenes alone, scored on people",
        "build/transfer",
    ),
    "preliminary": Program(
        "studies.thesis_preliminary.program",
        "the thesis' preliminary study again",
        "build/preliminary",
    ),
    "ablation": Program(
        "studies.ablation",
        "what each part of the method is worth",
        "build/ablation",
    ),
}

if __name__ == "__main__":
    sys.exit(start("studies", PROGRAMS, sys.argv[1:]))
