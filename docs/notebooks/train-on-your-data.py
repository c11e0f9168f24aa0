# %% [markdown]
# # Train on your data
#
# From a folder of trials to a sealed model file and its answers, in one program. The trials here
# are **simulated** and far too few for a good model: the figures show how it works, not how well.
# It is a Python file with cells: `make docs-site` executes it, and `python
# docs/notebooks/train-on-your-data.py` runs it too. Folders of CSV files need no program: [your
# own recordings](../your-data.md). Terms: [glossary](../glossary.md).
#
# ## Trials
#
# Two sets of trials from different seeds: one to train on, one to evaluate on.

# %%
import os
import tempfile
from pathlib import Path

import pandas as pd

from holdfast import evaluation, load_set
from holdfast.cli.main import main
from holdfast.edge_runtime.monitor import Model
from holdfast.export.exporting import export_artifact
from holdfast.training.fitting import train
from holdfast.training.plan import TWO_SAMPLES, ForestPlan, TrainingPlan

os.chdir(tempfile.mkdtemp())
work = Path("work")
for name, seed in (("mine", 1), ("unseen", 2)):
    command = ["simulate", "thesis", "--trials", "40", "--seed", str(seed)]
    main([*command, "--out", str(work / name)])

# %% [markdown]
# ## Train, export
#
# A small forest, so that this page is built in seconds. `holdfast train` without options trains a
# committee of trees and networks. `export_artifact` writes the model file only if it gives the
# same answers as scikit-learn.

# %%
data = load_set(work / "mine")
plan = TrainingPlan(
    situation=ForestPlan(n_estimators=20, min_samples_leaf=4, max_depth=12),
    decision=TWO_SAMPLES,
    folds=2,
)
train(data, work / "model", plan)
path, report = export_artifact(work / "model")
print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")

# %% [markdown]
# ## Answers on unseen trials
#
# A line a sample: the truth beside the answer.

# %%
model = Model(path)
unseen = load_set(work / "unseen", windows="natural")
answers = evaluation.to_frame(evaluation.run_model(model, unseen))
pd.crosstab(answers["truth"], answers["state"])

# %% [markdown]
# Most rows are on the diagonal; the first half second of each trial is `unknown`. Samples are not
# events: whether a slip was called in time says [`holdfast evaluate`](../your-data.md).
