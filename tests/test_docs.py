"""What the documentation says exists: links, commands, options, names, and examples that run."""

import ast
import re
import shlex
from importlib import import_module
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import typer

from calibrate import cli

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"^ *```.*?^ *```|^ {4}.*?$|`[^`]*`", re.MULTILINE | re.DOTALL)
BLOCK = re.compile(r"^( *)```(\w+)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
PROGRAM: Any = typer.main.get_command(cli.app)


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path, language: str) -> list[str]:
    """Blocks of code in a language, without their common indentation."""
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [re.sub(f"^{indent}", "", code, flags=re.M) for indent, kind, code in found
            if kind == language]  # fmt: skip


def commands(page: Path) -> list[list[str]]:
    lines = "\n".join(blocks(page, "sh")).splitlines()
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[1:] for line in words if line and line[0] == "calibrate"]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    for target in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
        if not target.startswith(("http://", "https://", "#")):
            assert (page.parent / target.partition("#")[0]).exists(), target


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=name_of)
def test_commands_and_their_options_exist(page):
    for verb, *arguments in commands(page):
        assert verb in PROGRAM.commands, verb
        known = {o for p in PROGRAM.commands[verb].params for o in (*p.opts, *p.secondary_opts)}
        given = {word.partition("=")[0] for word in arguments if word.startswith("--")}
        assert given <= known, (verb, given - known)


OURS = ("jdem", "calibrate")


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=name_of)
def test_names_in_examples_exist(page):
    """Ours; a page may show a library that only a cluster needs."""
    for code in blocks(page, "python"):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith(OURS):
                module = import_module(str(node.module))
                for alias in node.names:
                    assert hasattr(module, alias.name) or import_module(
                        f"{node.module}.{alias.name}"
                    )


# ------------------------------------------------------------------ the examples of CONTRIBUTING


@pytest.fixture(scope="module")
def examples() -> dict[str, type]:
    """Everything that the examples define, each run as a module of its own."""
    found: dict[str, type] = {}
    for number, code in enumerate(blocks(ROOT / "CONTRIBUTING.md", "python")):
        names: dict = {"__name__": f"example_{number}"}
        exec(compile(code, names["__name__"], "exec"), names)
        found.update(names)
    return found


def test_the_law_is_a_rolling_law(examples):
    from jdem.mechanics.contact import NormalForce

    law = examples["AdhesiveRolling"](0.1)
    normal = NormalForce(jnp.asarray(2.0), jnp.asarray(0.0), jnp.asarray(5.0))
    assert float(law.limit(normal)) == pytest.approx(0.5)


def test_the_effect_is_nothing_at_strength_0(examples):
    effect = examples["LoadCellBend"]
    reading = jnp.array([0.0, 200.0, 400.0])
    assert not np.any(effect(0.0).force_error(reading, reading))
    np.testing.assert_allclose(effect(1e-5).force_error(reading, reading), [0, 0.4, 1.6])


def test_the_test_states_its_movements(examples):
    test = examples["relaxation"](force=80.0)
    loading, holding = test.movements()
    assert test.names == ("loading", "holding")
    assert float(loading.segment.force_target) == 80.0
    assert float(holding.segment.platen_speed) == 0.0
    assert float(holding.time_scale * holding.segment.duration) == pytest.approx(60.0)


def test_the_strategy_finds_the_slopes_of_a_plane(examples):
    slopes = jnp.array([[1.0, -2.0], [0.5, 3.0]])

    def response(points):
        return points @ slopes.T + jnp.arange(points.shape[1])[None, :, None]

    strategy = examples["OneSided"]()
    found = strategy(response, jnp.array([0.3, -0.1]), 3)
    np.testing.assert_allclose(found.slopes, slopes, rtol=1e-6)
    assert found.values.shape == (3, 2)
    assert strategy.runs(2, 3) == 3 and eqx.is_array(found.standard_error)


def test_the_step_of_the_diagnosis_shares_out_a_residual(examples):
    from calibrate.discrepancy.comparison.projection import Projected

    fields = Projected.__dataclass_fields__
    given = {"residual": np.array([3.0, 4.0]), "effects": np.eye(2)}
    design = Projected(**{name: given.get(name) for name in fields})
    np.testing.assert_allclose(examples["shares"](design).share, [9 / 25, 16 / 25])
