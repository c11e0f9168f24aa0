"""How long `holdfast import` takes for a long log, over pandas' read_csv and to_csv of it.

`python -m benchmarks import` measures it: 2,000,000 rows of 18 channels, about 320 MB.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

import numpy as np
import pandas as pd

from holdfast.core.contract import Json

ROWS, ROWS_A_TRIAL = 2_000_000, 10_000
WRITE = "from benchmarks.long_import import write_log; write_log({log!r}, {rows})"
PANDAS = "import pandas as pd; pd.read_csv({log!r}).to_csv({out!r}, index=False)"
IMPORT = "from holdfast.cli.main import main; main({words!r})"


def write_log(path: str, rows: int) -> None:
    """Trials one after the other, at 1 kHz."""
    t_s = np.arange(rows) / 1000.0
    values = np.random.default_rng(0).normal(0.0, 0.02, (rows, 18))
    values[:, 2::3] += 3.0 * (np.abs(t_s % 10.0 - 5.0) < 3.0)[:, None]
    names = [f"s{k}_{axis}" for k in range(1, 7) for axis in "xyz"]
    table = pd.DataFrame(values.round(5), columns=names)
    table.insert(0, "time_s", t_s)
    table["run"] = np.arange(rows) // ROWS_A_TRIAL
    table.to_csv(path, index=False)


def measure(code: str) -> tuple[float, float]:
    """(CPU seconds, MB at its peak) of a program; its progress goes to the terminal.

    The peak of a program counts from that of the process that starts it, which must stay small: so
    the log is written by a program, too.
    """
    child = subprocess.Popen([sys.executable, "-c", code])
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"failed: {code}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3


def long_import(rows: int = ROWS) -> Json:
    """What an import and pandas took for one log, and the first over the second."""
    # the time, 18 channels and the number of the trial
    table_mb = rows * 20 * 8 / 1e6
    with tempfile.TemporaryDirectory() as folder:
        log, out = f"{folder}/log.csv", f"{folder}/out"
        measure(WRITE.format(log=log, rows=rows))
        words = ["import", log, "--out", out, "--yes", "--action", "slip"]
        programs = {
            "import": IMPORT.format(words=words),
            "pandas": PANDAS.format(log=log, out=f"{folder}/o.csv"),
        }
        took = {name: measure(code) for name, code in programs.items()}
    taken = []
    for name, (cpu_s, peak_mb) in took.items():
        over_table = round(peak_mb / table_mb, 2)
        row = {"cpu_s": round(cpu_s, 1), "peak_mb": round(peak_mb)}
        taken.append({"program": name, **row, "peak_over_table": over_table})
    over_pandas = took["import"][0] / took["pandas"][0]
    return {"rows": rows, "time_over_pandas": round(over_pandas, 2), "taken": taken}
