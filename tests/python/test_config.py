from __future__ import annotations

import ast
import inspect
import textwrap
from itertools import pairwise
from pathlib import Path

import pytest

from fuse_grounding.config import Config, Section
from fuse_grounding.errors import InputError


def test_defaults_are_the_papers_constants_but_for_what_was_chosen():
    c = Config()
    assert (c.gate.eta, c.search.revisit, c.evidence.within_reach) == (
        0.6,
        False,
        True,
    )  # paper: 0.8, True, False
    assert c.gate.temperature == 0.1
    assert (c.stopping.patience, c.budget.actions) == (5, 30)
    assert c.stopping.weights == (0.7, 0.3)
    assert (c.stopping.near_m, c.stopping.far_m, c.stopping.min_region_px) == (0.3, 1.2, 500)
    assert c.ssnr.alpha == 0.8
    assert (c.map.initial_iterations, c.map.incremental_iterations, c.map.degree) == (1000, 400, 3)
    assert (c.map.position_rate, c.map.position_rate_end) == (1.6e-4, 1.6e-6)
    assert (c.map.feature_rate, c.map.opacity_rate, c.map.scale_rate, c.map.rotation_rate) == (
        2.5e-3,
        2.5e-2,
        5e-3,
        1e-3,
    )
    assert (c.map.densify_interval, c.map.densify_start, c.map.densify_end) == (100, 500, 15000)
    assert c.map.opacity_reset_interval == 3000
    assert c.random.seed == 2


def documented(kind: type) -> set[str]:
    """Fields with a docstring, in the class or in one that it takes them from."""
    names = set()
    for base in kind.__mro__:
        if base.__module__.startswith("fuse_grounding"):
            body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body  # type: ignore[attr-defined]
            for field, after in pairwise(body):
                if isinstance(field, ast.AnnAssign) and isinstance(after, ast.Expr):
                    names.add(field.target.id)  # type: ignore[union-attr]
    return names


def test_every_setting_names_its_source():
    for section in Config.model_fields.values():
        kind = section.annotation
        if isinstance(kind, type) and issubclass(kind, Section):
            for name in kind.model_fields:
                assert name in documented(kind), f"{kind.__name__}.{name} has no source"


def test_toml_then_overrides_then_round_trip(tmp_path: Path):
    path = tmp_path / "run.toml"
    path.write_text('method = "explicit"\n[gate]\neta = 0.7\n[return]\ninclude_initial = false\n')
    c = Config.load(path, ["gate.eta=0.6", "knowledge.source=direct", "stopping.weights=[1.0, 1.0]"])
    assert (c.method, c.gate.eta, c.return_.include_initial) == ("explicit", 0.6, False)
    assert (c.knowledge.source, c.stopping.weights) == ("direct", (1.0, 1.0))
    assert Config.from_dict(c.to_dict()) == c


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[gate]\netta = 1", "{path}: unknown key `gate.etta`; did you mean `eta`?"),
        ("[gait]\neta = 1", "{path}: unknown key `gait`; did you mean `gate`?"),
        ("[gate]\neta = 1.5", "{path}: `gate.eta`: found 1.5, expected: less than or equal to 1"),
        ("[gate]\neta = nan", "{path}: `gate.eta`: found nan, expected: a finite number"),
        ("gate = 3", "{path}: `gate`: found 3, expected: a table of settings"),
        (
            "[explicit]\ncoupled = 'sum'",
            "{path}: `explicit.coupled`: found 'sum', expected: 'union', 'quadrant' or 'mean'",
        ),
        (
            "[stopping]\nnear_m = 2.0",
            "{path}: `stopping.near_m` must be below `stopping.far_m`, found 2.0 and 1.2",
        ),
    ],
)
def test_a_wrong_file_is_named_with_key_found_and_expected(tmp_path: Path, text: str, message: str):
    path = tmp_path / "run.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Config.load(path)
    assert str(caught.value) == message.format(path=path)


def test_an_override_is_blamed_itself_not_the_file(tmp_path: Path):
    path = tmp_path / "run.toml"
    path.write_text("[gate]\neta = 0.7")
    with pytest.raises(InputError, match=r"^--set budget.actions=-1: `budget.actions`: found -1"):
        Config.load(path, ["budget.actions=-1"])
    with pytest.raises(InputError, match=r"^--set eta: expected section.key=value"):
        Config.load(path, ["eta"])


def test_missing_and_broken_files_are_named(tmp_path: Path):
    with pytest.raises(InputError, match=r"nowhere.toml does not exist"):
        Config.load(tmp_path / "nowhere.toml")
    path = tmp_path / "broken.toml"
    path.write_text("[gate\n")
    with pytest.raises(InputError, match=r"broken.toml is not valid TOML"):
        Config.load(path)


def test_settings_cannot_be_changed_in_place():
    with pytest.raises(ValueError, match="frozen"):
        Config().gate.eta = 0.1
