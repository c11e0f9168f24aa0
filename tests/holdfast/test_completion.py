"""A shell completes commands, options and their values by the script that it is given."""

from __future__ import annotations

import subprocess

from command_line import Run

from holdfast.cli.main import VERBS

COMPLETE = """
source /dev/stdin
COMP_WORDS=(holdfast "$@")
COMP_CWORD=$#
_shtab_holdfast holdfast "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


def completed(script: str, *words: str) -> set[str]:
    """What bash offers for the last of the words."""
    command = ["bash", "-c", COMPLETE, "bash", *words]
    done = subprocess.run(
        command, input=script, capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_bash_completes_commands_options_and_choices(run: Run) -> None:
    script = run("doctor", "--completion", "bash")[1]
    assert completed(script, "sc") == {"scan"}
    assert set(VERBS) <= completed(script, "")
    assert completed(script, "run", "--cali") == {"--calibration"}
    assert completed(script, "run", "--conf") == {"--config"}
    assert completed(script, "run", "--engine", "") == {"auto", "onnxruntime", "c"}
