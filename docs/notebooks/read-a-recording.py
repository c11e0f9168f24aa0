# %% [markdown]
# # Read a recording
#
# This notebook simulates one trial, reads it, draws its forces, and asks the shipped model at
# every sample. Everything in it is simulated. It is a Python file with cells: `make docs-site`
# executes it, and `python docs/notebooks/read-a-recording.py` runs it too. Terms:
# [glossary](../glossary.md).
#
# ## A trial
#
# The card `thesis` describes the thesis' experiment; ten of its trials are enough here, and one
# is a pull. Your own trial is a folder that `holdfast record` wrote, or a CSV file ([your own
# recordings](../your-data.md)).

# %%
import os
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from holdfast.cli.main import main
from holdfast.drivers.replay import open_replay
from holdfast.edge_runtime.monitor import GripMonitor, Model
from holdfast.evaluation.style import (
    FINGER_COLOURS,
    FINGER_LINES,
    SITUATION_COLOURS,
    STYLE,
)

os.chdir(tempfile.mkdtemp())
folder = Path("trials")
main(["simulate", "thesis", "--trials", "10", "--out", str(folder)])
trial = sorted(folder.glob("*/pull/trial_1.csv"))[0]
print(trial)
table = pd.read_csv(trial)
table.iloc[400:404, :7].round(3)

# %% [markdown]
# `Time` is in seconds. Each finger has two axes along the skin, X and Y, and the normal Z, here
# in newtons.
#
# ## Without the bias
#
# A model takes forces without the bias of the open hand. Its card says how the bias is found.

# %%
model = Model("holdfast-150hz")
recording = open_replay(trial).prepared(model.card.preparation)
forces = recording.values.reshape(len(recording.values), -1, 3)
time_s = recording.t_ns / 1e9
print(
    f"{forces.shape[0]} samples of {forces.shape[1]} fingers at {recording.rate_hz:.0f} Hz"
)

# %% [markdown]
# ## Ask the model
#
# `feed` takes one sample and answers at once. A state of `unknown` at the start is normal: the
# model needs half a second of samples.

# %%
monitor = GripMonitor(model, None)
answers = [monitor.feed(sample) for sample in recording]
states = pd.Series([answer.state for answer in answers])
act_s = [t for t, answer in zip(time_s, answers, strict=True) if answer.act]
print(states.value_counts(sort=False).to_string())
print(f"first request to act: {act_s[0]:.3f} s")

# %% [markdown]
# ## Draw it
#
# Above, the normal force of every finger; below, the state at every sample. The line marks the
# first request to act.

# %% alt="Normal force of six fingers in a simulated pull, and the state at every sample below"
plt.rcParams.update({**STYLE, "font.size": 13})
fingers = ("thumb 1", "thumb 2", "index", "middle", "ring", "little")
figure, (above, below) = plt.subplots(
    2, 1, sharex=True, figsize=(6, 6), height_ratios=(2, 1)
)
for number, name in enumerate(fingers):
    colour, line = FINGER_COLOURS[number], FINGER_LINES[number]
    above.plot(time_s, forces[:, number, 2], line, color=colour, label=name)
figure.legend(frameon=False, ncols=3, loc="outside upper left")
above.set_ylabel("normal force, N")
names = ("nothing", "grasp", "safe_slip", "risky_slip")
for height, (name, colour) in enumerate(zip(names, SITUATION_COLOURS, strict=True)):
    here = (states == name).to_numpy()
    below.plot(time_s[here], [height] * here.sum(), "s", color=colour, markersize=6)
below.set_yticks(range(4), [name.replace("_", " ") for name in names])
below.set_ylim(-0.6, 3.6)
below.set_xlabel("time in the trial, s")
for axes in (above, below):
    axes.axvline(act_s[0], color="#1f2933", linewidth=0.8, linestyle=":")
plt.show()

# %% [markdown]
# The same answers as JSON lines, without a program: `holdfast replay holdfast-150hz TRIAL`.
