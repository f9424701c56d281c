"""Model files and rendering from Python: results of known scenes, and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fuse_grounding import _core
from fuse_grounding.errors import InputError

BOX = Path(__file__).parents[2] / "crates/fuse-render/tests/data/trimesh_box.glb"


def camera_above(height: float = 2.0, pixels: int = 64) -> _core.Camera:
    """Looks straight down at the origin; image up is world y."""
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    half = pixels / 2
    translation = np.array([0.0, 0.0, height])
    return _core.Camera(pixels, pixels, half, half, half, half, rotation, translation)


def test_model_round_trip(tmp_path: Path) -> None:
    model = _core.load_model(BOX)
    assert model.triangle_count == 12
    low, high = model.bounds
    np.testing.assert_allclose(np.subtract(high, low), [0.4, 0.2, 0.3], atol=1e-5)
    assert model.materials == ["paint"]
    model.save_glb(tmp_path / "box.glb")
    assert _core.load_model(tmp_path / "box.glb").bounds == model.bounds


def test_render_depth_ids_and_colour() -> None:
    model = _core.load_model(BOX)
    low, high = np.array(model.bounds)
    # Box on the floor at the origin, twice as large.
    transform = np.eye(4, dtype=np.float32)
    transform[:3, :3] *= 2
    transform[:3, 3] = -(low + high)
    transform[2, 3] = -2 * low[2]
    rgb, depth, ids = _core.render_models([model], transform[None], camera_above(), ids=[9])
    assert rgb.shape == (64, 64, 3)
    assert rgb.dtype == np.uint8
    assert ids[32, 32] == 9
    assert depth[32, 32] == pytest.approx(2.0 - 0.6, abs=1e-5)
    assert ids[2, 2] == 0
    assert depth[2, 2] == pytest.approx(2.0, abs=1e-5)
    # 0.8 x 0.4 m at 1.4 m and 32 px focal length.
    assert (ids == 9).sum() == pytest.approx(0.8 * 0.4 * (32 / 1.4) ** 2, rel=0.08)
    again = _core.render_models([model], transform[None], camera_above(), ids=[9])
    np.testing.assert_array_equal(rgb, again[0])
    _, depth, ids = _core.render_models([model], transform[None], camera_above(), floor=None, shadows=False)
    assert depth[2, 2] == 0
    assert ids[32, 32] == 1


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.glb"):
        _core.load_model(tmp_path / "missing.glb")
    cut = tmp_path / "cut.glb"
    cut.write_bytes(BOX.read_bytes()[:900])
    with pytest.raises(InputError, match=r"cut\.glb.*truncated"):
        _core.load_model(cut)
    model = _core.load_model(BOX)
    eye = np.eye(4, dtype=np.float32)[None]
    camera = camera_above()
    with pytest.raises(InputError, match=r"transforms must be a \(N, 4, 4\) float32"):
        _core.render_models([model], eye.astype(np.float64), camera)
    with pytest.raises(InputError, match=r"transforms must have shape \(2, 4, 4\)"):
        _core.render_models([model, model], eye, camera)
    with pytest.raises(InputError, match="transforms must be finite"):
        _core.render_models([model], eye * np.nan, camera)
    with pytest.raises(InputError, match="invertible"):
        _core.render_models([model], np.diag([1, 1, 0, 1]).astype(np.float32)[None], camera)
    with pytest.raises(InputError, match="one id for each"):
        _core.render_models([model], eye, camera, ids=[1, 2])
    with pytest.raises(InputError, match="background"):
        _core.render_models([model], eye, camera, background=[-1.0, 0.0, 0.0])
