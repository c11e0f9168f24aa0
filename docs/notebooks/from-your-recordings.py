# %% [markdown]
# # From your recordings to a judged model
#
# Logs of another program, as they come: semicolons, decimal commas, milliseconds, one file a trial,
# and a table of events. Two commands make a model of them, `import` and `train`; `check` says what
# is missing. The logs are written here from a few **simulated** trials, far too few for a good
# model: the figures show how it works, not how well. What each command can do more: [your own
# recordings](../your-data.md). Terms: [glossary](../glossary.md).
#
# ## The logs
#
# Three people, each with their own trials. A row is a time and three axes of six fingertips, in mN.

# %%
import json
import os
import tempfile
from pathlib import Path

import pandas as pd

from holdfast import evaluation, load_set
from holdfast.cli.main import main
from holdfast.edge_runtime.monitor import Model

os.chdir(tempfile.mkdtemp())
Path("lab/logs").mkdir(parents=True)
main(["simulate", "thesis", "--trials", "36", "--rate", "100", "--out", "simulated"])

people = ("anna", "ben", "carla")
meaning = {"safe_slip": "lets go", "risky_slip": "slips"}
events = []
for n, path in enumerate(sorted(Path("simulated").glob("*/[pf]*/trial_?.csv"))):
    item, action = path.parts[1:3]
    log = f"{people[n % 3]}_{item}_{action}_{n}.csv"
    frame = pd.read_csv(path)
    table = frame.drop(columns="Time").mul(1000.0).round(1)
    table.insert(0, "time [ms]", (1000.0 * frame["Time"]).round(3))
    table.to_csv(f"lab/logs/{log}", sep=";", decimal=",", index=False)
    for phase in json.loads(path.with_suffix(".truth.json").read_text())["phases"]:
        if phase["label"] in meaning:
            events.append([log, phase["t0_s"], phase["t1_s"], meaning[phase["label"]]])
pd.DataFrame(events, columns=["log", "from", "to", "what"]).to_csv(
    "lab/events.csv", sep=";", decimal=",", index=False
)
print(Path(f"lab/logs/{log}").read_text()[:140])

# %% [markdown]
# ## Import: a column map says what is what
#
# Without a map, `holdfast import` finds one from what the columns hold, says what it understood,
# and asks what nothing tells. Here it is written out.

# %%
sensors = "\n".join(
    f'[[sensors]]\nx = "X{k}"\ny = "Y{k}"\nz = "Z{k}"' for k in range(1, 7)
)
Path("map.toml").write_text(f"""
unit = "mN"
[time]
column = "time [ms]"
unit = "ms"
{sensors}
[trials]
path = "{{person}}_{{object}}_{{action}}_{{trial}}"
[events]
file = "../events.csv"
trial = "log"
start = "from"
end = "to"
label = "what"
[events.labels]
"lets go" = "safe_slip"
"slips" = "risky_slip"
""")
assert main(["import", "lab/logs", "--map", "map.toml", "--out", "trials"]) == 0

# %% [markdown]
# ## Check: what is there, and what is missing
#
# It reads every trial and says what to write where. An ERROR would end with another code than 0.

# %%
assert main(["check", "trials"]) == 0

# %% [markdown]
# ## Train on two people, with a report
#
# Carla's trials stay away. A forest alone and a tiny one, so that this page is built in seconds;
# without these two options a committee of trees and networks is trained. Each of both people is
# answered by a model that was trained without them, and `train.html` shows the figures, a trial in
# full and what to do next.

# %%
Path("unseen").mkdir()
Path("trials/carla").rename("unseen/carla")
for name in ("meta.json", "hand.toml"):
    if Path("trials", name).is_file():
        Path("unseen", name).write_text(Path("trials", name).read_text())
command = (
    "train --data trials --learner forest --size tiny --out model --report train.html"
)
assert main(command.split()) == 0

# %% [markdown]
# ## A judged model: answers on a person that it has never seen
#
# Whether each slip was called in time, and each hand-over left alone, trial by trial.

# %%
model = "model/holdfast.onnx"
main(["evaluate", model, "--data", "unseen", "--report", "evaluate.html"])

# %% [markdown]
# A line a sample: the truth beside the answer.

# %%
data = load_set(Path("unseen"), windows="natural")
answers = evaluation.to_frame(evaluation.run_model(Model(model), data))
pd.crosstab(answers["truth"], answers["state"])

# %% [markdown]
# Next: more people, more objects, and both kinds of slips of each ([how to
# record](../recording-and-study.md)). Then run it on the hand:
# `holdfast run model/holdfast.onnx --source URL` ([live page](../on-a-hand.md#the-live-page)).
