"""Evidence against an OpenCV and NumPy twin in double precision, and at every documented edge."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from fuse_grounding import evidence
from fuse_grounding.errors import InputError

EPSILON = 1e-8


def twin(
    observed: np.ndarray, rendered: np.ndarray, gradient: str = "magnitude"
) -> tuple[np.ndarray, np.ndarray]:
    """SSNR in decibels by the supplement's formula, and where that is well conditioned.

    boxFilter updates a sum from its neighbour's, so that a faint window beside a strong one keeps
    an error of the strong one's size. It is trusted where summing each window anew changes the
    result by less than 1e-4 dB.
    """
    border = cv2.BORDER_REFLECT_101

    def sobel(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scale = 255.0 if image.dtype == np.uint8 else 1.0
        grey = image.astype(np.float64) @ np.array([0.299, 0.587, 0.114]) / scale
        return (
            cv2.Sobel(grey, cv2.CV_64F, 1, 0, ksize=3, borderType=border),
            cv2.Sobel(grey, cv2.CV_64F, 0, 1, ksize=3, borderType=border),
        )

    def updated(field: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(field, cv2.CV_64F, (11, 11), normalize=False, borderType=border)

    def anew(field: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(field, cv2.CV_64F, np.ones(11), np.ones(11), borderType=border)

    (ix, iy), (rx, ry) = sobel(observed), sobel(rendered)
    signal = ix**2 + iy**2
    if gradient == "magnitude":
        noise = (np.hypot(ix, iy) - np.hypot(rx, ry)) ** 2
    else:
        noise = (ix - rx) ** 2 + (iy - ry) ** 2

    def decibels(window: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        a, b = np.maximum(window(signal), 0), np.maximum(window(noise), 0)
        return np.clip(10 * np.log10((a + EPSILON) / (b + EPSILON)), -30, 30)

    db = decibels(updated)
    return db, np.abs(db - decibels(anew)) < 1e-4


def noise(seed: int, shape: tuple[int, int]) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3), dtype=np.uint8)


def natural(seed: int, shape: tuple[int, int]) -> np.ndarray:
    """Structure at all scales (amplitude falling as 1 / frequency), as photographs have."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None]) + 1 / max(shape)
    channels = []
    for _ in range(3):
        field = np.fft.ifft2(np.fft.fft2(rng.standard_normal(shape)) / frequency).real
        channels.append(128 + 50 * (field - field.mean()) / field.std())
    return np.clip(np.stack(channels, -1), 0, 255).astype(np.uint8)


def steps(seed: int, shape: tuple[int, int]) -> np.ndarray:
    """Black and white blocks, with a texture of one level of blue in some."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(0, 2, (shape[0] // 9 + 1, shape[1] // 9 + 1), dtype=np.uint8) * 255
    image = np.kron(blocks, np.ones((9, 9), np.uint8))[: shape[0], : shape[1], None].repeat(3, 2)
    image[..., 2] ^= rng.integers(0, 2, shape, dtype=np.uint8) * np.uint8(image.shape[0] % 2)
    return image


def flat(seed: int, shape: tuple[int, int]) -> np.ndarray:
    return np.full((*shape, 3), (seed * 37 % 256, 90, 200), np.uint8)


KINDS = [noise, natural, steps, flat]


@pytest.mark.parametrize("shape", [(12, 12), (13, 17), (37, 101), (240, 320), (481, 641)])
@pytest.mark.parametrize("gradient", ["magnitude", "vector"])
def test_ssnr_agrees_with_the_twin(shape: tuple[int, int], gradient: evidence.Gradient):
    for i, observe in enumerate(KINDS):
        for j, render in enumerate(KINDS):
            observed, rendered = observe(i, shape), render(j + 9, shape)
            expected, sure = twin(observed, rendered, gradient)
            assert sure.mean() > 0.99
            difference = np.abs(evidence.ssnr(observed, rendered, gradient=gradient) - expected)
            worst = difference[sure].max()
            assert worst < 1e-3, f"{observe.__name__} against {render.__name__}: {worst} dB"


def test_a_blurred_rendering_agrees_with_the_twin_over_the_whole_range():
    observed = natural(1, (480, 640))
    expected_range = []
    for sigma in (0.3, 1.0, 3.0):
        rendered = cv2.GaussianBlur(observed, (0, 0), sigma)
        expected, sure = twin(observed, rendered)
        assert sure.all()
        assert np.abs(evidence.ssnr(observed, rendered) - expected).max() < 1e-3
        expected_range += [expected.min(), expected.max()]
    assert max(expected_range) - min(expected_range) > 15


def test_uncertainty_is_the_inverted_and_scaled_ratio():
    observed, rendered = natural(2, (60, 80)), natural(3, (60, 80))
    db = evidence.ssnr(observed, rendered)
    np.testing.assert_allclose(
        evidence.geometric_uncertainty(observed, rendered), 0.8 * (1 - (db + 30) / 60), atol=1e-6
    )
    ratio = 10 ** (db.astype(np.float64) / 10)
    spatial = 0.5 * (1 - (ratio - ratio.min()) / np.ptp(ratio))
    np.testing.assert_allclose(
        evidence.geometric_uncertainty(observed, rendered, alpha=0.5, normalization="spatial"),
        spatial,
        atol=1e-5,
    )


def test_float_renderings_are_compared_in_8_bits_unless_asked():
    observed, rendered = natural(4, (48, 64)), natural(5, (48, 64))
    floats = ((rendered + 0.3) / 255).astype(np.float32)
    floats[0, 0] = (-0.2, 1.7, 0.5)
    rendered[0, 0] = (0, 255, 128)
    np.testing.assert_array_equal(evidence.ssnr(observed, floats), evidence.ssnr(observed, rendered))
    direct = evidence.ssnr(observed, floats, float_render=True)
    assert np.abs(direct - twin(observed, floats)[0]).max() < 1e-3
    assert np.abs(direct - evidence.ssnr(observed, rendered)).max() > 1e-3


def test_known_values_of_equal_flat_and_missing():
    picture, blank = noise(6, (30, 40)), flat(1, (30, 40))
    assert (evidence.ssnr(picture, picture) == 30).all()
    assert (evidence.ssnr(blank, flat(2, (30, 40))) == 0).all()
    assert (evidence.ssnr(blank, picture) == -30).all()
    assert np.abs(evidence.ssnr(picture, blank)).max() < 1e-4
    assert (evidence.ssnr(picture, None) == 0).all()
    assert (evidence.geometric_uncertainty(picture, None) == np.float32(0.4)).all()
    assert (evidence.geometric_uncertainty(picture, None, missing_db=-30) == np.float32(0.8)).all()
    assert evidence.geometric_uncertainty(picture, None).shape == (30, 40)


def test_views_that_are_not_contiguous_are_read_right():
    a, b = natural(7, (40, 60)), natural(8, (40, 60))
    np.testing.assert_array_equal(
        evidence.ssnr(a[:, ::2], b[:, ::2]), evidence.ssnr(a[:, ::2].copy(), b[:, ::2].copy())
    )
    bgr = evidence.ssnr(a[..., ::-1], b[..., ::-1])
    np.testing.assert_array_equal(bgr, evidence.ssnr(a[..., ::-1].copy(), b[..., ::-1].copy()))
    a.flags.writeable = False
    assert evidence.ssnr(a, b).shape == (40, 60)


def test_bits_do_not_depend_on_the_number_of_threads():
    script = (
        "import numpy as np, hashlib; from fuse_grounding import evidence;"
        "r = np.random.default_rng(0); a, b = r.integers(0, 256, (2, 211, 333, 3), dtype=np.uint8);"
        "print(hashlib.sha256(evidence.ssnr(a, b).tobytes()).hexdigest())"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", script],
            env=os.environ | {"RAYON_NUM_THREADS": threads},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for threads in ("1", "2", "5")
    }
    assert len(digests) == 1


def test_semantic_map_takes_the_best_score_at_each_pixel():
    rng = np.random.default_rng(1)
    masks, scores = rng.random((7, 33, 41)) < 0.3, rng.random(7).astype(np.float32)
    expected = np.where(masks, scores[:, None, None], 0).max(0)
    np.testing.assert_array_equal(evidence.semantic_map(masks, scores), expected)
    np.testing.assert_allclose(
        evidence.semantic_map(masks, scores.tolist(), normalize=True), expected / expected.max(), rtol=1e-6
    )
    assert not evidence.semantic_map(np.zeros((0, 4, 5), bool), []).any()
    assert not evidence.semantic_map(np.zeros((1, 4, 5), bool), [0.9], normalize=True).any()


def test_fusion():
    s, g = np.random.default_rng(2).random((2, 5, 6), dtype=np.float32)
    np.testing.assert_array_equal(evidence.fuse(s, g), s + g)
    np.testing.assert_allclose(evidence.fuse(s, g, 0.5, 2.0), 0.5 * s + 2 * g, rtol=1e-6)
    np.testing.assert_array_equal(evidence.functional_uncertainty(s, g), 1 - s + g)


@pytest.mark.parametrize("shape", [(6, 8), (7, 9), (480, 640)])
def test_action_scores_are_means_over_the_documented_halves(shape: tuple[int, int]):
    e = np.random.default_rng(3).random(shape, dtype=np.float32)
    rows, columns = np.indices(shape)
    right, lower = columns >= shape[1] // 2, rows >= shape[0] // 2
    scores = evidence.action_scores(e)
    drawn = evidence.regions(*shape)
    for index, (ring, pitch) in enumerate(evidence.ACTIONS):
        horizontal = right if ring > 0 else ~right
        vertical = lower if pitch > 0 else ~lower
        region = np.zeros(shape, bool) if (ring or pitch) else np.ones(shape, bool)
        region |= horizontal & bool(ring) | vertical & bool(pitch)
        np.testing.assert_array_equal(drawn[index], region)
        assert scores[index] == pytest.approx(e[region].mean(dtype=np.float64), rel=1e-6)
    np.testing.assert_array_equal(evidence.action_scores(e, [14, 0, 7]), scores[[14, 0, 7]])
    mean = evidence.action_scores(e, coupled="mean")
    assert mean[14] == pytest.approx((scores[8] + scores[12]) / 2, rel=1e-6)
    quadrant = evidence.action_scores(e, coupled="quadrant")
    assert quadrant[14] == pytest.approx(e[right & lower].mean(dtype=np.float64), rel=1e-6)


def test_choice_breaks_ties_by_stride_then_index():
    e = np.zeros((8, 8), np.float32)
    e[:, 4:] = 1
    scores, everything = evidence.action_scores(e), np.ones(15, bool)
    assert evidence.ACTIONS[evidence.choose_action(scores, everything)] == (1, 0)
    assert evidence.ACTIONS[evidence.choose_action(scores, everything, stride="two")] == (2, 0)
    stay = np.arange(15) == evidence.NOOP
    assert evidence.choose_action(scores, stay, noop=True) == evidence.NOOP
    with pytest.raises(InputError, match=r"^no action is feasible: mask has no true element among 15$"):
        evidence.choose_action(scores, stay)


def test_entropy_agrees_with_scipy():
    entropy = pytest.importorskip("scipy.stats").entropy
    rng = np.random.default_rng(4)
    for n in (2, 10, 15):
        values, mask = rng.normal(size=n), np.arange(n) % 3 != 2
        for kept, m in ((values, None), (values[mask], mask)):
            p = np.exp(kept / 0.1)
            expected = entropy(p / p.sum()) / np.log(len(kept))
            assert evidence.action_entropy(values, mask=m) == pytest.approx(expected, abs=1e-6)
    assert evidence.action_entropy([0.2] * 15) == 1
    assert evidence.action_entropy([0.2, np.nan], mask=[True, False]) == 0


def test_proximity_of_a_pixel_is_that_of_a_region_of_one_pixel():
    depth = np.array([[0.2, 0.5, 1.0, 1.2], [3.0, 0.0, np.nan, -1.0]], np.float32)
    found = evidence.proximity_map(depth, near=0.3, far=1.1)
    for place in np.ndindex(depth.shape):
        pixel = np.zeros(depth.shape, bool)
        pixel[place] = True
        alone = evidence.depth_proximity(depth, pixel, near=0.3, far=1.1, min_pixels=1)
        assert found[place] == pytest.approx(alone, abs=1e-6)
    with pytest.raises(InputError, match=r"near must be at least 0 and below far, found 1\.2 and 0\.3"):
        evidence.proximity_map(depth, near=1.2, far=0.3)


def test_depth_proximity():
    depth = np.full((40, 40), 0.75, np.float32)
    region = np.ones((40, 40), bool)
    assert evidence.depth_proximity(depth, region) == pytest.approx(0.5)
    depth[:20] = [np.nan, 0, -1, np.inf] * 10
    assert evidence.depth_proximity(depth, region) == pytest.approx(0.5)
    assert evidence.depth_proximity(np.full_like(depth, np.nan), region) == 0
    assert evidence.depth_proximity(depth, np.zeros_like(region)) == 0
    small = np.zeros_like(region)
    small.flat[-499:] = True
    assert evidence.depth_proximity(depth, small) == 0
    assert evidence.depth_proximity(depth, small, min_pixels=499) == pytest.approx(0.5)
    assert evidence.depth_proximity(depth, region, near=0.5, far=1.0) == pytest.approx(0.5)


def test_grounding_score_and_patience():
    assert evidence.grounding_score(0.8, 0.5, 500) == pytest.approx(0.71)
    assert evidence.grounding_score(0.8, 0.5, 500, weights=(1, 1)) == pytest.approx(1.3)
    assert evidence.grounding_score(0.8, None, 500) == pytest.approx(0.56)
    assert evidence.grounding_score(0.8, 0.5, 499) is None
    patience = evidence.Patience(2)
    assert [patience.observe(s) for s in (None, 0.1, 0.1)] == [False, True, False]
    assert not patience.exhausted
    assert not patience.observe(None)
    assert (patience.exhausted, patience.best, patience.failures, patience.k) == (True, 0.1, 2, 2)


PICTURE = np.zeros((12, 16, 3), np.uint8)
NAN_PICTURE = np.full((12, 16, 3), np.nan, np.float32)
MAP = np.zeros((12, 16), np.float32)
NAN_MAP = np.full((12, 16), np.nan, np.float32)
MASKS = np.ones((2, 12, 16), bool)

BAD = [
    (lambda: evidence.ssnr(MAP, PICTURE),
     "observed must be a (H, W, 3) uint8 array, found float32 array of shape (12, 16)"),
    (lambda: evidence.ssnr([[1]], PICTURE),  # type: ignore[arg-type]
     "observed must be a (H, W, 3) uint8 array, found list"),
    (lambda: evidence.ssnr(PICTURE[..., :2], PICTURE),
     "observed must be a (H, W, 3) uint8 array with H, W > 0, found shape [12, 16, 2]"),
    (lambda: evidence.ssnr(PICTURE[:0], None),
     "observed must be a (H, W, 3) uint8 array with H, W > 0, found shape [0, 16, 3]"),
    (lambda: evidence.ssnr(PICTURE, PICTURE.astype(np.float64)),
     "rendered must be a (H, W, 3) uint8 or float32 array, found float64 array of shape (12, 16, 3)"),
    (lambda: evidence.ssnr(PICTURE, PICTURE[:, :8]),
     "rendered must be 16x12 pixels like observed, found 8x12"),
    (lambda: evidence.geometric_uncertainty(PICTURE, NAN_PICTURE),
     "rendered must be finite, found NaN at flat index 0"),
    (lambda: evidence.geometric_uncertainty(PICTURE, None, alpha=-1),
     "alpha must be finite and not negative, found -1"),
    (lambda: evidence.geometric_uncertainty(PICTURE, None, normalization="log"),  # type: ignore[arg-type]
     "normalization must be 'decibel' or 'spatial', found 'log'"),
    (lambda: evidence.ssnr(PICTURE, None, gradient="sum"),  # type: ignore[arg-type]
     "gradient must be 'magnitude' or 'vector', found 'sum'"),
    (lambda: evidence.ssnr(PICTURE, None, gray_range=0), "gray_range must be positive and finite, found 0"),
    (lambda: evidence.ssnr(PICTURE, None, missing_db=40), "missing_db must be in [-30, 30] dB, found 40"),
    (lambda: evidence.semantic_map(MASKS.astype(np.uint8), [0.1, 0.2]),
     "masks must be a (N, H, W) bool array, found uint8 array of shape (2, 12, 16)"),
    (lambda: evidence.semantic_map(MASKS[0], [0.1]),
     "masks must be a (N, H, W) bool array, found bool array of shape (12, 16)"),
    (lambda: evidence.semantic_map(MASKS, [0.1]), "scores must have 2 elements, found 1"),
    (lambda: evidence.semantic_map(MASKS, [0.1, np.nan]), "scores must be in [0, 1], found NaN"),
    (lambda: evidence.semantic_map(MASKS, [[0.1, 0.2]]),
     "scores must be a list of numbers, found float64 array of shape (1, 2)"),
    (lambda: evidence.fuse(MAP, MAP[:6]), "geometric must be 16x12 pixels like semantic, found 16x6"),
    (lambda: evidence.fuse(NAN_MAP, MAP), "semantic must be finite, found NaN at flat index 0"),
    (lambda: evidence.fuse(MAP.astype(np.float64), MAP),
     "semantic must be a (H, W) float32 array, found float64 array of shape (12, 16)"),
    (lambda: evidence.action_scores(NAN_MAP), "evidence must be finite, found NaN at flat index 0"),
    (lambda: evidence.action_scores(MAP[:1]), "evidence must be at least 2x2 pixels, found 16x1"),
    (lambda: evidence.action_scores(MAP, [15]), "actions must be indices from 0 to 14, found 15"),
    (lambda: evidence.action_scores(MAP, coupled="sum"),  # type: ignore[arg-type]
     "coupled must be 'union' or 'quadrant' or 'mean', found 'sum'"),
    (lambda: evidence.choose_action(np.zeros(14), np.ones(15, bool)),
     "scores must have 15 elements, found 14"),
    (lambda: evidence.choose_action(np.zeros(15), np.arange(15)),
     "mask must be a list of booleans, found int64 array of shape (15,)"),
    (lambda: evidence.action_entropy([0.1, np.nan]), "values must be finite, found NaN at flat index 1"),
    (lambda: evidence.action_entropy([0.1, 0.2], mask=[False, False]),
     "no action is feasible: mask has no true element among 2"),
    (lambda: evidence.action_entropy([], 0.1), "no action is feasible: mask has no true element among 0"),
    (lambda: evidence.action_entropy([0.1, 0.2], temperature=0),
     "temperature must be positive and finite, found 0"),
    (lambda: evidence.depth_proximity(MAP, MASKS[0, :6]), "mask must be 16x12 pixels like depth, found 16x6"),
    (lambda: evidence.depth_proximity(MAP.astype(np.uint16), MASKS[0]),
     "depth must be a (H, W) float32 array, found uint16 array of shape (12, 16)"),
    (lambda: evidence.depth_proximity(MAP, MASKS[0], near=2),
     "far must be finite and greater than near, found 1.2"),
    (lambda: evidence.grounding_score(np.nan, 0.1, 900), "score must be in [0, 1], found NaN"),
    (lambda: evidence.grounding_score(0.1, 0.1, -1),
     "pixels must be a whole number from 0 to 2147483647, found -1"),
    (lambda: evidence.Patience(0), "k must be at least 1, found 0"),
    (lambda: evidence.Patience(-1), "k must be a whole number from 1 to 4294967295, found -1"),
    (lambda: evidence.Patience().observe(np.nan), "score must be finite, found NaN"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "message"), BAD)
def test_bad_input_is_named(call, message: str):
    with pytest.raises(InputError) as caught:
        call()
    assert str(caught.value) == message
