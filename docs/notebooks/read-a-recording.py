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

import holdfast
from holdfast.cli.main import main
from holdfast.evaluation.style import SITUATION_COLOURS

os.chdir(tempfile.mkdtemp())
folder = Path("trials")
main(["simulate", "thesis", "--trials", "10", "--out", str(folder)])
path = sorted(folder.glob("*/pull/trial_1.csv"))[0]
print(path)
table = pd.read_csv(path)
table.iloc[400:404, :7].round(3)

# %% [markdown]
# `Time` is in seconds. Each finger has two axes along the skin, X and Y, and the normal Z, here
# in newtons.
#
# ## Ask the model
#
# `replay` takes arrays of a whole recording, from here or from anywhere, and returns arrays: one
# answer a row ([API](../api.md)). A state of `unknown` at the start is normal: the model needs
# half a second of samples.

# %%
trial = holdfast.read_trial(path)
monitor = holdfast.load("holdfast-150hz")
answers = monitor.replay(trial.raw, trial.t_s, valid=trial.valid, unit="N")
states = pd.Series(answers.state)
act_s = answers.t_s[answers.act]
print(states.value_counts(sort=False).to_string())
print(f"first request to act: {act_s[0]:.3f} s")

# %% [markdown]
# ## Without the bias
#
# The model took forces without the bias of the open hand, which its card finds in the first rows.

# %%
forces = answers.values.reshape(len(answers.values), -1, 3)
time_s = answers.t_s
print(f"{forces.shape[0]} samples of {forces.shape[1]} fingers")

# %% [markdown]
# ## Draw it
#
# Above, the normal force of every finger; below, the state at every sample. The line marks the
# first request to act.

# %% alt="Normal force of six fingers in a simulated pull, and the state at every sample below"
plt.rcParams["font.size"] = 13
fingers = ("thumb 1", "thumb 2", "index", "middle", "ring", "little")
figure, (above, below) = plt.subplots(
    2, 1, sharex=True, figsize=(6, 6), height_ratios=(2, 1)
)
for number, name in enumerate(fingers):
    # The fingers opposite the thumb are dashed.
    line = "-" if number < 2 else "--"
    above.plot(time_s, forces[:, number, 2], line, label=name)
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
