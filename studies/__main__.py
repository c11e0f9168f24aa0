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
    "nested-choice": Program(
        "studies.real.nested_choice",
        "taxels, features and learner chosen on people, never on those that are scored",
        "build/real",
    ),
    "people": Program(
        "studies.people.program",
        "false alarms and squeezing in plain lifts by people who are left out",
        "build/people",
    ),
    "models": Program(
        "studies.models",
        "the shipped files, made anew from scenes and lifts",
        "build/models",
    ),
    "evaluate": Program(
        "studies.default_model",
        "the default model on unseen simulated sets, with baselines",
        "build/evaluate",
    ),
    "same-labels": Program(
        "studies.same_labels",
        "two files of one training: how many answers differ, sample by sample",
        "build/same-labels",
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
    "adapt": Program(
        "studies.adapt",
        "what adapting to a person brings, simulated",
        "build/adapt-study",
    ),
    "preliminary": Program(
        "studies.thesis_preliminary.program",
        "the thesis' preliminary study again",
        "build/preliminary",
    ),
}

if __name__ == "__main__":
    sys.exit(start("studies", PROGRAMS, sys.argv[1:]))
