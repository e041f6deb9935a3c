"""`hrl-escape completion`: what a real bash offers with the script that it prints."""

import shutil
import subprocess

import pytest

from hrl_escape.cli import main
from hrl_escape.env.presets import PRESETS


@pytest.fixture(scope="module")
def script(tmp_path_factory) -> str:
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(["completion", "bash"]) == 0
    return printed.getvalue()


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash on this machine")
@pytest.mark.parametrize(("line", "offered"), [
    ("tr", {"train"}),
    ("ladder r", {"run", "report"}),
    ("train smdp-factored", {"smdp-factored-r-max"}),
    ("watch smdp-untried-n", {"smdp-untried-nearest"}),
    ("train dqn --leav", {"--leaves"}),
    ("train maxq-q --leaves ", {"planned", "learned"}),
    ("play --preset pap", {name for name in PRESETS if name.startswith("pap")}),
    ("ladder run --proto", {"--protocol"}),
    ("list refer", {"references"}),
    ("record --driv", set()),
    ("nonsense ", set()),
])
def test_bash_offers_what_fits(script: str, line: str, offered: set[str]):
    words = ["hrl-escape", *line.split(" ")]
    program = f'{script}\nCOMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _hrl_escape; printf "%s\\n" "${{COMPREPLY[@]}}"'
    done = subprocess.run(["bash", "-c", program, "bash", *words], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == offered and done.stderr == ""


def test_zsh_is_told_to_read_it_as_bash_does(capsys):
    assert main(["completion", "zsh"]) == 0
    assert capsys.readouterr().out.startswith("autoload -Uz bashcompinit && bashcompinit\n")
