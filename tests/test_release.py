"""A release people can install: the workflow of a tag, the base requirements, and notebooks that install it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from hrl_escape import __version__
from hrl_escape.files import read_toml

ROOT = Path(__file__).parents[1]
PROJECT = read_toml(ROOT / "pyproject.toml", "project")["project"]


def list_runs() -> list[str]:
    workflow = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text())
    assert workflow[True]["push"]["tags"] == ["v*"]  # YAML reads the key `on` as true
    (job,) = workflow["jobs"].values()
    return [step["run"] for step in job["steps"] if "run" in step]


@pytest.mark.parametrize(("tag", "passes"), [(f"v{__version__}", True), ("v0.0.1", False), (f"v{__version__}0", False)])
def test_a_tag_must_be_the_version(tag: str, passes: bool):
    check = list_runs()[0]
    done = subprocess.run(["bash", "-c", check], cwd=ROOT, env={**os.environ, "GITHUB_REF_NAME": tag})
    assert (done.returncode == 0) is passes


def test_a_tag_builds_wheel_and_site_by_targets_that_exist():
    targets = [run.removeprefix("make ") for run in list_runs() if run.startswith("make ")]
    assert targets == ["dist", "docs"]  # in this order, because `dist` removes what was built before
    makefile = (ROOT / "Makefile").read_text()
    assert all(f"\n{target}: " in makefile for target in targets)


def test_pybullet_is_required_where_it_has_wheels_and_an_extra_elsewhere():
    (bullet,) = [need for text in PROJECT["dependencies"] if (need := Requirement(text)).name == "pybullet"]
    assert bullet.marker is not None
    here = {"sys_platform": "linux", "platform_machine": "x86_64", "python_version": "3.11"}
    places = [here, {**here, "python_version": "3.10"}, {**here, "python_version": "3.12"},
              {**here, "platform_machine": "aarch64"}, {**here, "sys_platform": "darwin", "platform_machine": "arm64"}]
    assert [bullet.marker.evaluate(place) for place in places] == [True, True, False, False, False]
    assert [Requirement(text).name for text in PROJECT["optional-dependencies"]["bullet"]] == ["pybullet"]


def test_the_base_package_requires_nothing_of_viewer_docs_and_bench():
    base = {Requirement(text).name for text in PROJECT["dependencies"]}
    for extra in ("viewer", "docs", "bench", "data", "tensorboard"):
        names = {Requirement(text).name for text in PROJECT["optional-dependencies"][extra]}
        assert not (names - {"gymnasium"}) & base, extra


def test_the_first_cell_of_a_notebook_installs_what_the_tutorial_imports(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "_ext"))
    tutorials = pytest.importorskip("tutorials")
    for name, wanted in (("own_play_minigrid", "hrl-escape[bench,data]"), ("first_escape", "hrl-escape")):
        cell = tutorials.make_install_cell((ROOT / f"docs/tutorials/{name}.py").read_text())
        assert f'    %pip install -q "{wanted}"' in cell.splitlines()
        python = cell.replace("%pip", "raise SystemExit #")
        exec(compile(python, name, "exec"), {})  # does nothing where the package is installed
    sys.modules.pop("tutorials", None)
