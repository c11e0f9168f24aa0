"""`holdfast convert`: what other tools' own readers find in the files, losses included."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from command_line import fails
from lossy_set import NEVER_CAME, PASS, PULL, ROWS, Written, write_lossy_set
from mcap.reader import make_reader
from packages import ROOT

from holdfast.cli.convert import WRITERS
from holdfast.core.contract import channel_names
from holdfast.interop.formats.payload import read_payloads

Run = Callable[..., tuple[int, str, str]]
CHANNELS = list(channel_names(6))
VALID = [f"valid{k}" for k in range(1, 7)]
PAGE = ROOT / "docs/formats.md"


@pytest.fixture(scope="module")
def recorded(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, dict[str, Written]]:
    root = tmp_path_factory.mktemp("set") / "trials"
    return root, write_lossy_set(root)


@pytest.fixture
def converted(
    run: Run, recorded: tuple[Path, dict[str, Written]], tmp_path: Path
) -> Callable[..., Path]:
    """Converts the set as recorded; returns the folder."""

    def convert(form: str, *options: str) -> Path:
        code, out, err = run(
            "convert",
            recorded[0],
            "--to",
            form,
            "--out",
            tmp_path / form,
            "--raw",
            *options,
        )
        assert code == 0, err
        assert "trials" in out
        return tmp_path / form

    return convert


def test_pandas_reads_a_folder_of_parquet_as_one_table(converted, recorded):
    table = pd.read_parquet(converted("parquet"))
    assert len(table) == 2 * ROWS
    for name, written in recorded[1].items():
        rows = table[table["trial"] == name]
        np.testing.assert_allclose(rows["Time"], written.t_s, atol=1e-8)
        np.testing.assert_allclose(rows[CHANNELS], written.values, rtol=1e-8)
        np.testing.assert_array_equal(rows[VALID], written.valid)
        assert [
            label if isinstance(label, str) else None for label in rows["label"]
        ] == (written.label)
        assert set(rows["person"]) == {name[:3]}


def test_parquet_says_units_and_has_nulls_where_a_sample_was_lost(converted):
    path = converted("parquet") / f"{PULL}.parquet"
    table = pq.read_table(path)
    assert table.schema.field("Time").metadata == {b"unit": b"s"}
    assert table.schema.field("Z6").metadata == {b"unit": b"N"}
    about = json.loads(table.schema.metadata[b"holdfast"])
    assert (about["mass_g"], about["labels_by"], about["person"]) == (
        15.1,
        "key",
        "p01",
    )
    assert table.column("X1").null_count == len(NEVER_CAME)
    assert table.column("X3").null_count == len(NEVER_CAME) + 1
    assert table.column("valid1").null_count == 0


def test_without_raw_the_values_are_without_the_bias_that_is_written_down(
    run, recorded, tmp_path
):
    root, written = recorded
    assert (
        run(
            "convert", root, "--to", "parquet", "--out", tmp_path / "o", "--only", PASS
        )[0]
        == 0
    )
    assert [path.name for path in (tmp_path / "o").iterdir()] == ["p02"]
    table = pq.read_table(tmp_path / "o" / f"{PASS}.parquet")
    about = json.loads(table.schema.metadata[b"holdfast"])
    values = np.column_stack([table.column(name).to_numpy() for name in CHANNELS])
    again = (values + about["bias"]) * about["sign"]
    np.testing.assert_allclose(again, written[PASS].values, atol=1e-8)
    assert np.abs(values[:5].mean(axis=0)).max() < 1e-9


def test_the_mcap_package_reads_values_labels_and_losses(converted, recorded):
    written = recorded[1][PULL]
    path = converted("mcap") / f"{PULL}.mcap"
    read: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            read.setdefault(channel.topic, []).append(json.loads(message.data))
        about = {record.name: record.metadata for record in reader.iter_metadata()}[
            "holdfast"
        ]
    values, situations = (read[topic] for topic in ("/tactile/fingers", "/situation"))
    numbers = [
        [one[axis] for one in row["fingers"] for axis in "xyz"] for row in values
    ]
    np.testing.assert_allclose(
        np.array(numbers, dtype=float), written.values, rtol=1e-8
    )
    assert [
        [one["valid"] for one in row["fingers"]] for row in values
    ] == written.valid.tolist()
    assert [one["situation"] for one in situations] == [
        "nothing",
        "grasp",
        "risky_slip",
        "unlabelled",
    ]
    assert {row["unit"] for row in values} == {"N"}
    assert json.loads(about["object"]) == "soft-ball"


def test_lerobot_s_layout_holds_every_frame_and_nothing_filled(converted, recorded):
    folder = converted("lerobot")
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"]) == ("v3.0", 100)
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (
        2,
        2 * ROWS,
        2,
    )
    data = pd.read_parquet(
        folder / info["data_path"].format(chunk_index=0, file_index=0)
    )
    assert set(data) == set(info["features"])
    episodes = pd.read_parquet(folder / "meta/episodes/chunk-000/file-000.parquet")
    tasks = pd.read_parquet(folder / "meta/tasks.parquet")
    for (_, episode), written in zip(
        episodes.iterrows(), recorded[1].values(), strict=True
    ):
        frames = data[episode["dataset_from_index"] : episode["dataset_to_index"]]
        assert set(frames["episode_index"]) == {episode["episode_index"]}
        np.testing.assert_allclose(
            np.stack(frames["observation.tactile"]), written.values, rtol=1e-6
        )
        np.testing.assert_array_equal(
            np.stack(frames["observation.tactile_valid"]), written.valid
        )
        np.testing.assert_allclose(frames["observation.time_s"], written.t_s, atol=1e-8)
        assert tasks.index[frames["task_index"].iloc[0]] == episode["tasks"][0]
    stats = json.loads((folder / "meta/stats.json").read_text())["observation.tactile"]
    together = np.concatenate([one.values for one in recorded[1].values()])
    np.testing.assert_allclose(stats["mean"], np.nanmean(together, axis=0), rtol=1e-5)


def test_an_output_that_exists_is_kept_and_an_unknown_trial_is_an_error(
    run, recorded, tmp_path
):
    root, _ = recorded
    (tmp_path / "o").mkdir()
    (tmp_path / "o/mine").write_text("mine")
    words = ("convert", root, "--to", "parquet", "--out")
    fails(run, 5, "OutputError", *words, tmp_path / "o", says="not empty")
    fails(run, 3, "DataNotFound", *words, tmp_path / "p", "--only", "p09/*", says=PULL)
    assert [path.name for path in tmp_path.iterdir()] == ["o"]


def test_the_page_s_commands_run_and_name_every_format(run, tmp_path, monkeypatch):
    page = PAGE.read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL):
        if not block.startswith("holdfast "):
            subprocess.run(["sh", "-e", "-c", block], check=True)
            continue
        for line in block.splitlines():
            code, _, err = run(*shlex.split(line)[1:])
            assert code == 0, err
    assert sorted(path.name for path in Path("build/interop").iterdir()) == sorted(
        ["set", *WRITERS]
    )
    assert all(f"| `{form}` |" in page for form in WRITERS)


def test_sign_and_bias_are_those_of_rows_that_are_valid(tmp_path: Path) -> None:
    t_s = np.arange(300) / 100.0
    values = np.tile([1.0, 2.0, 20.0], (300, 1))
    values[100:200, 2] += 5.0
    values[:3] = -150.0
    columns = {"Time": t_s, **dict(zip(channel_names(1), values.T, strict=True))}
    columns["valid1"] = (np.arange(300) >= 3).astype(float)
    path = tmp_path / "set/mug/hold/trial_1.csv"
    path.parent.mkdir(parents=True)
    pd.DataFrame(columns).to_csv(path, index=False)
    (payload,) = read_payloads(tmp_path / "set")
    assert payload.about["sign"] == [1.0, 1.0, 1.0]
    assert payload.about["bias"] == [1.0, 2.0, 20.0]
