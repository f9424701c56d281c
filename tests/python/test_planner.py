"""The learned planner: what it reads, its network and files, its training, how it is judged, its gate."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_networks import write_encoder, write_planner

from fuse_grounding.benchmark.methods import resolve
from fuse_grounding.config import Config
from fuse_grounding.environment import load_episodes
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.knowledge.protocol import Candidate
from fuse_grounding.perception.embedded_encoder import EmbeddedEncoder
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.planning.amortized import KINDS, WEIGHTS, Network, load_planner, shipped
from fuse_grounding.planning.context import nearest_candidate
from fuse_grounding.planning.protocol import Situation
from fuse_grounding.planning.summary import NAMES, mirrored, summarize
from fuse_grounding.record import Stopwatch
from fuse_grounding.training import gate, planner_score, transitions
from fuse_grounding.training.transitions import Transitions

H, W = 48, 64


def situation(detections: list[Detection] | None = None, depth: float | None = 0.75) -> Situation:
    feasible = np.ones(15, bool)
    feasible[10:] = False  # the lower pitch: further down is masked
    return Situation(
        index=0,
        rgb=np.random.default_rng(0).integers(0, 255, (H, W, 3), np.uint8),
        feasible=feasible,
        candidates=[Candidate("knife", 1.0, ""), Candidate("mug", 0.5, "")],
        detections=detections or [],
        depth=None if depth is None else np.full((H, W), depth, np.float32),
        pitch_index=2,
    )


@pytest.fixture(scope="module")
def encoder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_encoder(tmp_path_factory.mktemp("encoder"))


def settings(encoder: Path, planner: Path, name: str = "plain", method: str = "amortized") -> Config:
    return Config().with_(
        method=method,
        planner={"name": name, "weights": str(planner)},
        encoder={"weights": str(encoder)},
    )


# -- what it reads ------------------------------------------------------------------------------------


def test_the_summary_says_where_the_candidates_are():
    left, right = np.zeros((H, W), bool), np.zeros((H, W), bool)
    left[0:16, 0:16] = True
    right[32:40, 40:48] = True
    config = Config().with_(stopping={"min_region_px": 50})
    seen = situation([Detection("mug", 0.4, right), Detection("knife", 0.8, left)])
    found = dict(zip(NAMES, summarize(seen, config).tolist(), strict=True))
    assert (found["pitch_0"], found["pitch_1"], found["pitch_2"]) == (0, 0, 1)
    assert found["semantic_00"] == pytest.approx(0.8)
    assert found["semantic_22"] == pytest.approx(0.4 * 64 / 256)
    assert found["semantic_11"] == 0
    assert found["best_score"] == pytest.approx(0.8)
    assert (found["best_x"], found["best_y"]) == pytest.approx((8 / 64, 8 / 48))
    assert found["best_size"] == pytest.approx(np.sqrt(256 / (H * W)))
    assert found["best_depth_m"] == pytest.approx(0.75)
    assert found["best_fused"] == pytest.approx(0.7 * 0.8 + 0.3 * 0.5)
    touches = [found[f"best_touches_{side}"] for side in ("left", "right", "top", "bottom")]
    assert touches == [1, 0, 1, 0]
    assert (found["second_score"], found["second_x"], found["second_y"]) == pytest.approx(
        (0.4, 44 / 64, 36 / 48)
    )
    assert found["detections_of_10"] == pytest.approx(0.2)
    nothing = summarize(situation([], depth=None), config)
    assert nothing[NAMES.index("pitch_2")] == 1
    assert nothing.sum() == 1


def test_a_mirrored_summary_is_that_of_the_mirrored_picture():
    corner, middle = np.zeros((H, W), bool), np.zeros((H, W), bool)
    corner[3:30, 0:14] = True
    middle[20:33, 37:52] = True
    config = Config().with_(stopping={"min_region_px": 50})
    for seen in ([("mug", 0.4, middle), ("knife", 0.8, corner)], [("mug", 0.6, middle)], []):
        there = summarize(situation([Detection(*one) for one in seen]), config)
        turned = summarize(
            situation([Detection(label, score, mask[:, ::-1]) for label, score, mask in seen]), config
        )
        np.testing.assert_allclose(mirrored(there[None])[0], turned, atol=1e-6)
        np.testing.assert_allclose(mirrored(mirrored(there[None]))[0], there, atol=1e-6)


def test_the_object_context_is_the_candidate_most_like_the_picture():
    class Axes:
        name = "axes"

        def text(self, labels: Any) -> np.ndarray:
            return np.eye(3, dtype=np.float32)[[("knife", "mug", "pen").index(label) for label in labels]]

    image = np.array([0.1, 0.2, 0.9], np.float32)
    encoder: Any = Axes()
    assert nearest_candidate(encoder, image, ["knife", "mug"]) == "mug"
    assert nearest_candidate(encoder, image, ["knife", "pen", "mug"]) == "pen"


# -- network and policy -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["plain", "summary"])
def test_the_policy_takes_the_best_feasible_action(encoder: Path, tmp_path: Path, kind: str):
    values = np.zeros(15)
    values[12], values[7], values[3] = 0.9, 0.5, 0.4  # the best is masked, the next one stays
    planner = write_planner(tmp_path / "p.onnx", encoder, kind, values)
    method, config = resolve(settings(encoder, planner, kind))
    policy = method.policy(config, 0)
    assert not method.maps
    assert policy.planner == kind
    clock = Stopwatch()
    decision = policy.decide(situation(), clock)
    assert (decision.action, decision.branch) == (7, "amortized")
    assert decision.values is not None
    assert np.flatnonzero(np.isnan(decision.values)).tolist() == [10, 11, 12, 13, 14]
    np.testing.assert_allclose(decision.values[:10], values[:10])
    assert "predict" in clock.seconds


def test_the_learned_planner_goes_on_to_new_views_too(encoder: Path, tmp_path: Path):
    values = np.zeros(15)
    values[7], values[8], values[9] = 0.9, 0.6, 0.3  # stay, or go right, where it has been
    planner = write_planner(tmp_path / "p.onnx", encoder, values=values)
    been = replace(situation(), visited=[(0, 2), (35, 2)])
    for method in ("amortized", "fuse"):
        for revisit, action in ((False, 9), (True, 7)):
            chosen, config = resolve(
                settings(encoder, planner, method=method).with_(search={"revisit": revisit})
            )
            decision = chosen.policy(config, 0).decide(been, Stopwatch())
            assert (decision.branch, decision.action) == ("amortized", action)
            assert decision.values is not None
            assert np.isnan(decision.values[[7, 8]]).all() == (not revisit)


def test_the_gate_uses_it(encoder: Path, tmp_path: Path):
    values = np.zeros(15)
    values[8] = 1.0
    planner = write_planner(tmp_path / "p.onnx", encoder, values=values)
    method, config = resolve(settings(encoder, planner, method="fuse"))
    decision = method.policy(config, 0).decide(situation(), Stopwatch())
    assert (decision.branch, decision.action) == ("amortized", 8)
    _, plain = resolve(Config().with_(method="fuse", planner={"name": "none"}))
    assert load_planner(plain) is None


def test_an_agents_provenance_names_planner_and_encoder(encoder: Path, tmp_path: Path):
    from fuse_grounding.assembly import assemble

    planner = write_planner(tmp_path / "p.onnx", encoder)
    parts, _ = assemble(settings(encoder, planner))
    assert set(parts.provenance["sha256"]) == {"segmenter", "encoder", "planner", "planner_encoder"}
    reader = write_planner(tmp_path / "s.onnx", encoder, "summary")
    parts, _ = assemble(settings(encoder, reader, "summary"))
    assert set(parts.provenance["sha256"]) == {"segmenter", "encoder", "planner"}
    parts, _ = assemble(settings(encoder, planner).with_(method="static"))
    assert set(parts.provenance["sha256"]) == {"segmenter", "encoder"}


def test_planners_that_do_not_fit_are_refused(encoder: Path, tmp_path: Path):
    planner = write_planner(tmp_path / "p.onnx", encoder)
    with pytest.raises(InputError, match=r"of a planner `plain`, planner\.name asks for `summary`"):
        load_planner(settings(encoder, planner, "summary"))
    (tmp_path / "other").mkdir()
    other = write_encoder(tmp_path / "other", seed=1)
    with pytest.raises(
        InputError, match=r"p\.onnx was trained with another encoder than .*its network differs"
    ):
        load_planner(settings(other, planner))
    (tmp_path / "narrow").mkdir()
    narrow = write_encoder(tmp_path / "narrow", dimensions=64)
    wide = write_planner(tmp_path / "wide.onnx", narrow)
    with pytest.raises(InputError, match=r"on vectors of 512 dimensions, the encoder `embedded` gives 64"):
        load_planner(settings(narrow, wide))


def test_damaged_planner_files_are_refused_by_name(encoder: Path, tmp_path: Path):
    planner = write_planner(tmp_path / "p.onnx", encoder)
    described = planner.with_suffix(".json")
    whole, text = planner.read_bytes(), described.read_text()
    planner.write_bytes(whole[:-5])
    with pytest.raises(InputError, match=r"p\.onnx is damaged or not the file that p\.json describes"):
        Network(planner)
    planner.write_bytes(whole)
    for broken, sentence in (
        (text[:40], "is not a planner's settings file"),
        (text.replace('"schema_version": 1', '"schema_version": 2'), "schema version 2, expected 1"),
        (text.replace('"plain"', '"wild"'), "`kind` must be plain or summary, found `wild`"),
        (text.replace('"plain"', '"summary"'), "is another network: it takes image"),
        (text.replace("512", "64"), r"is another network: it takes image \[1, 512\]"),
    ):
        described.write_text(broken)
        with pytest.raises(InputError, match=sentence):
            Network(planner)


# -- tables -------------------------------------------------------------------------------------------


def tables(states: int = 60, seed: int = 0, dimensions: int = 512) -> Transitions:
    """Every action measured in every state. What is worth doing is written in the picture's first numbers:
    the best action is the one whose own number is largest."""
    rng = np.random.default_rng(seed)
    feature = rng.standard_normal((states, dimensions))
    feature[:, :3] *= 15.0
    feature /= np.linalg.norm(feature, axis=1, keepdims=True)
    feasible = np.ones((states, 15), bool)
    feasible[::3, :5] = False
    before, action = np.nonzero(feasible)
    terms = np.zeros((len(before), 5), np.float32)
    terms[:, 0] = feature[before, action // 5]
    return Transitions(
        texts=np.eye(4, dimensions).astype(np.float16),
        number=np.arange(states // 2, dtype=np.int32),
        feature=feature.astype(np.float16),
        summary=rng.standard_normal((states, len(NAMES))).astype(np.float16),
        levels=np.zeros((states, 5), np.float32),
        feasible=feasible,
        context=rng.integers(0, 4, states).astype(np.int32),
        candidates=np.ones((states, 4), bool),
        viewpoint=np.zeros((states, 2), np.int32),
        trajectory=(np.arange(states) // 2).astype(np.int32),
        step=np.zeros(states, np.int32),
        before=before.astype(np.int32),
        after=before.astype(np.int32),
        action=action.astype(np.int32),
        terms=terms,
        utility=transitions.utility(terms),
    )


def test_utility_is_the_papers_sum():
    before = np.array([0.2, 0.5, 0.1, 0.4, 0.3], np.float32)
    after = np.array([0.5, 0.3, 0.3, 0.9, 0.1], np.float32)
    terms = transitions.gains(before, after)
    np.testing.assert_allclose(terms, [0.3, 0.2, 0.2, 0.5, -0.2], atol=1e-6)
    assert transitions.utility(terms) == pytest.approx(0.3 + 0.1 + 0.2 + 0.1 - 0.2)
    assert transitions.utility(np.full(5, 2.0)) == 1.0
    assert transitions.utility(np.full(5, -2.0)) == -1.0


def test_tables_come_back_and_are_joined(tmp_path: Path):
    one, two = tables(4, 0), tables(6, 1)
    (tmp_path / "t").write_bytes(transitions.joined([one, two]).encode({"labels": ["a"]}))
    found, note = transitions.load(tmp_path / "t")
    assert note == {"labels": ["a"]}
    assert len(found) == len(one) + len(two)
    np.testing.assert_array_equal(found.feature[found.before[len(one) :]], two.feature[two.before])
    np.testing.assert_array_equal(found.trajectory, [0, 0, 1, 1, 2, 2, 3, 3, 4, 4])


def test_tables_that_do_not_fit_together_are_refused_by_name(tmp_path: Path):
    from fuse_grounding import tensors

    path, good = tmp_path / "t.safetensors", tables(4)
    with pytest.raises(InputError, match=r"t\.safetensors does not exist"):
        transitions.load(path)
    content = good.encode({})
    wrong = {
        "is not a sound safetensors file": content[: len(content) // 2],
        "holds no planner transitions: its kind is `none`": b"\x02\0\0\0\0\0\0\0{}",
        "has schema version 9, expected 1": tensors.encode(transitions.KIND, 9, good.arrays(), {}),
        r"`utility` is float32 of shape \(3,\), expected float32 of \(50\)": replace(
            good, utility=good.utility[:3]
        ).encode({}),
        "`action` must be from 0 to 14, found 0 to 15": replace(
            good, action=np.where(good.action == 14, 15, good.action)
        ).encode({}),
        "an `action` is not `feasible` where it was taken": replace(
            good, feasible=np.zeros_like(good.feasible)
        ).encode({}),
        "`utility` is not the weighted sum of `terms`": replace(good, utility=good.utility + 0.1).encode({}),
        "`summary` has values that are not finite": replace(
            good, summary=np.full_like(good.summary, np.nan)
        ).encode({}),
    }
    for sentence, bad in wrong.items():
        path.write_bytes(bad)
        with pytest.raises(InputError, match=rf"t\.safetensors.*{sentence}"):
            transitions.load(path)


# -- training and judgement ---------------------------------------------------------------------------


def test_the_papers_network_learns_and_repeats_itself(tmp_path: Path):
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from fuse_grounding.training import planner as training

    data = tables(32)
    made: dict[str, Path] = {}
    plain: Any = None
    short, paper = replace(training.settings("plain", 0), epochs=2), training.settings("plain", 0)
    for kind, name, config in (
        ("plain", "again", short),
        ("plain", "first", short),
        ("summary", "first", replace(training.settings("summary", 0), epochs=2)),
        ("plain", "paper", paper),
    ):
        if name == "paper":
            assert made["plain"].read_bytes() == (tmp_path / "again" / "plain.onnx").read_bytes()
        trained = training.train(data, config, lambda line: None)
        (tmp_path / name).mkdir(exist_ok=True)
        made[kind] = tmp_path / name / f"{kind}.onnx"
        training.write(made[kind], trained, config, {"network": "n", "text": "t"}, {"sha256": "s"})
        sizes = [tuple(m.weight.shape) for m in trained.net.mlp if isinstance(m, torch.nn.Linear)]
        assert (
            sizes
            == {
                "plain": [(512, 1056), (512, 512), (1, 512)],
                "summary": [(128, len(NAMES) + 32), (128, 128), (1, 128)],
            }[kind]
        )
        assert trained.net.actions.weight.shape == (15, 32)
        assert made[kind].stat().st_size < 2e6
        plain = trained if kind == "plain" else plain
    assert len(plain.training) == 20
    assert plain.held_out[-1] < 0.6 * plain.constant
    assert (paper.learning_rate, paper.batch, paper.weight_decay, paper.dropout) == (1e-3, 64, 0.0, 0.0)
    network = Network(made["plain"])
    others = tables(40, seed=9)
    found = planner_score.choices(others, planner_score.by_network(others, network))
    scored = planner_score.score(found)
    assert scored["rank_correlation"]["within_states"] > 0.5
    assert scored["gained_on_random"]["low"] > 0
    with torch.no_grad():
        rows = [torch.from_numpy(x.astype(np.float32)) for x in (data.feature[:1], data.texts[:1])]
        expected = training.Exported(plain.net)(*rows).numpy()
    values = network.values(image=data.feature[0], object=data.texts[0])
    np.testing.assert_allclose(values, expected, atol=5e-3)  # weights are halved


def test_the_network_of_summaries_knows_left_from_right_from_half_of_the_cases():
    """It learns where to go from targets on the left alone, and is asked about targets on the right."""
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from fuse_grounding.training import planner as training

    def worth(ring: np.ndarray, x: np.ndarray) -> np.ndarray:
        return (0.4 * (ring - 2) * np.sign(x - 0.5)).astype(np.float32)

    data = tables(80)
    rng = np.random.default_rng(3)
    at = {name: i for i, name in enumerate(NAMES)}
    summary = np.zeros((80, len(NAMES)), np.float16)
    summary[:, at["best_score"]] = 0.9
    summary[:, at["best_x"]] = rng.uniform(0.05, 0.45, 80)
    ring = data.action % 5
    terms = np.zeros_like(data.terms)
    terms[:, 0] = worth(ring, summary[data.before, at["best_x"]])
    learnt = training.train(
        replace(data, summary=summary, terms=terms, utility=transitions.utility(terms)),
        training.settings("summary", 0),
        lambda line: None,
    )
    right = summary[:1].copy()
    right[0, at["best_x"]] = 0.8
    with torch.no_grad():
        values = training.Exported(learnt.net)(torch.from_numpy(right.astype(np.float32))).numpy()
    expected = worth(np.arange(15) % 5, np.full(15, 0.8))
    assert planner_score.rank_correlation(values, expected) > 0.9


def choices(measured: list[list[float]], predicted: list[list[float]]) -> planner_score.Choices:
    full = [np.full((len(rows), 15), np.nan) for rows in (measured, predicted)]
    for table, rows in zip(full, (measured, predicted), strict=True):
        for i, row in enumerate(rows):
            table[i, 5 : 5 + len(row)] = row
    return planner_score.Choices(full[0], full[1], np.array([0.2, 0.9]), np.arange(2), np.arange(2))


def test_regret_is_what_the_best_action_would_have_added():
    found = choices([[0.0, 0.4, 0.1], [0.3, -0.3, 0.0]], [[0.9, 0.5, 0.1], [0.2, 0.1, 0.0]])
    np.testing.assert_allclose(found.top, [0.4, 0.0])
    np.testing.assert_allclose(found.stay, [0.3, 0.3])  # staying is action 7
    np.testing.assert_allclose(found.random, [0.4 - 0.5 / 3, 0.3])
    scored = planner_score.score(found)
    assert scored["regret"]["top"] == {"mean": 0.2, "low": 0.0, "high": 0.4}
    gate = {side["eta"]: side for side in scored["gate"]}
    assert (gate[0.6]["trusted"], gate[0.6]["regret_trusted"], gate[0.6]["regret_left"]) == (0.5, 0.4, 0.0)
    assert gate[0.9]["regret_left"] is None
    assert scored["entropy_regret_correlation"] == -1.0


def test_rank_correlation_is_spearmans():
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 6, 50), rng.integers(0, 6, 50) + rng.integers(0, 3, 50)
    assert planner_score.rank_correlation(a, b) == pytest.approx(stats.spearmanr(a, b).statistic)
    assert np.isnan(planner_score.rank_correlation(a, np.zeros(50)))


def test_only_states_with_every_action_are_judged():
    data = tables(4)
    few = replace(
        data,
        **{n: getattr(data, n)[:-1] for n in ("before", "after", "action", "terms", "utility")},
    )
    found = planner_score.choices(few, lambda state: np.arange(15.0))
    assert len(found.measured) == 3
    one = replace(
        data, **{n: getattr(data, n)[:1] for n in ("before", "after", "action", "terms", "utility")}
    )
    with pytest.raises(InputError, match="no state has every feasible action measured"):
        planner_score.choices(one, lambda state: np.arange(15.0))


def test_the_command_trains_and_judges(tmp_path: Path, encoder: Path, capsys: pytest.CaptureFixture[str]):
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    pytest.importorskip("matplotlib")
    from fuse_grounding.cli.app import execute

    digests = json.loads(encoder.with_suffix(".json").read_text())["sha256"]
    note = {"split": "dev", "encoder": digests}
    source = tmp_path / "t.safetensors"
    source.write_bytes(tables(8).encode(note))
    line = f"train planner --transitions {source} --out {tmp_path / 'p'}"
    assert execute([*line.split(), "--kind", "plain"]) == 0
    assert "always the mean" in capsys.readouterr().out
    judged = [*line.split(), "--kind", "plain", "--evaluate", "--weights", str(tmp_path / "p"), "--json"]
    assert execute(judged) == 2
    assert "was trained on" in capsys.readouterr().err
    source.write_bytes(tables(8, seed=1).encode(note))
    assert execute(judged) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((tmp_path / "p" / "evaluation.json").read_text())
    assert told["planners"]["plain"]["states"] == 8
    assert (tmp_path / "p" / "gate_calibration.png").stat().st_size > 5000
    source.write_bytes(tables(8).encode({**note, "encoder": {"network": "x", "text": "y"}}))
    assert execute(judged) == 2
    assert "are of different encoders" in capsys.readouterr().err
    source.write_bytes(tables(8).encode({}))
    assert execute(judged) == 2
    assert "does not say of which split it is" in capsys.readouterr().err


def test_what_ships_was_trained_on_the_transitions_that_the_repository_keeps():
    kept = Path(__file__).parents[2] / "data" / "planner" / "transitions.safetensors"
    data, note = transitions.load(kept)
    card = json.loads(kept.with_suffix(".json").read_text())
    digest = hashlib.sha256(kept.read_bytes()).hexdigest()
    assert (card["sha256"], card["transitions"], note["split"]) == (digest, len(data), "train")
    assert kept.stat().st_size <= 10e6
    assert note["encoder"] == EmbeddedEncoder().settings.sha256
    for kind in KINDS:
        settings = Network(shipped(kind)).settings
        assert (settings.kind, settings.transitions) == (kind, digest)


def test_the_states_that_planners_are_judged_by_are_others_and_whole():
    kept = Path(__file__).parents[2] / "data" / "planner" / "judged.safetensors"
    data, note = transitions.load(kept)
    card = json.loads(kept.with_suffix(".json").read_text())
    assert (card["sha256"], note["split"]) == (hashlib.sha256(kept.read_bytes()).hexdigest(), "dev")
    assert note["encoder"] == EmbeddedEncoder().settings.sha256
    judged = planner_score.choices(data, planner_score.by_network(data, Network(shipped("summary"))))
    assert len(judged.state) == len(np.unique(data.before)) == 75
    assert len(data) == np.count_nonzero(data.feasible[judged.state]) == 930


# -- the gate's threshold -----------------------------------------------------------------------------


class _Episode:
    def __init__(self, name: str, split: str = "dev"):
        self.episode_id, self.split = name, split


@pytest.mark.skipif(not (WEIGHTS / "gate.json").exists(), reason="no choice of the threshold is recorded yet")
def test_the_default_threshold_is_the_recorded_choice():
    recorded = json.loads((WEIGHTS / "gate.json").read_text())
    assert Config().gate.eta == recorded["chosen"]
    assert recorded["episodes"] == [e.episode_id for e in load_episodes("dev")[:5]]


def test_the_threshold_with_most_successes_is_chosen(
    encoder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    planner = write_planner(tmp_path / "p.onnx", encoder)

    def play(agent: Any, method: str, episode: Any, index: int) -> dict[str, Any]:
        eta = agent.config.gate.eta
        return {
            "status": "ok",
            "episode_id": episode.episode_id,
            "success": index == 0 or eta >= 0.7,
            "iou": 0.9 if eta == 0.7 else 0.8,
            "online_actions": 9,
            "branches": {"explicit": 4, "amortized": 5},
            "wall_seconds": 1.0,
        }

    monkeypatch.setattr(gate, "run_one", play)
    config = settings(encoder, planner, method="fuse")
    heard: list[float] = []
    episodes: Any = [_Episode("dev_0000"), _Episode("dev_0001")]
    result = gate.tune(config, episodes, lambda eta, row: heard.append(eta))
    assert result["chosen"] == 0.7
    assert [p["success"] for p in result["curve"]] == [0.5, 1.0, 1.0, 1.0]
    assert heard == [0.6, 0.6, 0.7, 0.7, 0.8, 0.8, 0.9, 0.9]
    assert {"planner", "encoder"} <= set(result["provenance"]["sha256"])
    with pytest.raises(InputError, match="episode eval_0 is for evaluation: nothing is tuned on it"):
        gate.tune(config, [_Episode("eval_0", "eval")], lambda eta, row: None)  # type: ignore[list-item]
    with pytest.raises(InputError, match="there is no planner whose gate could be tuned"):
        gate.tune(config.with_(planner={"name": "none"}), episodes, lambda eta, row: None)
    monkeypatch.setattr(gate, "run_one", lambda *_: {"status": "failed", "error": "boom"})
    with pytest.raises(FuseError, match=r"dev_0000 failed at eta 0\.6: boom"):
        gate.tune(config, episodes, lambda eta, row: None)
