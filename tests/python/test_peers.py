"""What the comparison with other trainers computes from their files and logs."""

import struct
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))

from peers import opensplat, scene, table
from peers.process import Failed, replace_all


def image(number: int, name: str, points: int) -> bytes:
    head = struct.pack("<I7dI", number, 1, 0, 0, 0, number, 0, 0, 1) + name.encode() + b"\0"
    return head + struct.pack("<Q", points) + bytes(24 * points)


def test_images_that_are_held_out_are_gone_and_the_others_keep_their_poses() -> None:
    data = struct.pack("<Q", 3) + image(1, "a.png", 2) + image(2, "b.png", 0) + image(3, "c.png", 5)
    kept = scene.filter_images(data, {"a.png", "c.png"})
    assert kept == struct.pack("<Q", 2) + image(1, "a.png", 0) + image(3, "c.png", 0)


def test_a_step_takes_the_time_between_lines_after_the_first_ones() -> None:
    lines = [
        (1.0, "Loading"),
        (9.0, "Step 1: 0.2 (0%)"),
        (10.0, "Step 2: 0.2 (0%)"),
        (10.5, "Step 3: 0.1 (0%)"),
    ]
    assert opensplat.step_seconds(lines, 1) == 0.5
    with pytest.raises(Failed, match="did 3 steps"):
        opensplat.step_seconds(lines, 2)


def test_a_training_takes_what_its_gaussians_take() -> None:
    grown = {0: 100, 500: 100, 1000: 300}
    timed = {100: 0.1, 300: 0.3}
    assert table.train_seconds(timed, grown, 500) == pytest.approx(50)
    assert table.train_seconds(timed, grown, 1000) == pytest.approx(50 + 500 * 0.2)
    assert table.train_seconds(timed, grown, 2500) is None
    assert table.train_seconds({}, grown, 500) is None


def test_the_table_divides_theirs_by_ours_at_the_same_gaussians() -> None:
    row = {"gaussians": 100, "peak_mib": 9.0}
    results = {
        "OpenSplat": {
            "iterations": {"rows": [row | {"seconds": 0.4}]},
            "quality": {"maps": {"1000": {"psnr": 20.0, "gaussians": 100}}},
        },
        "torch-splatting": {"failed": "needs torch"},
        "fuse": {
            "iterations": {"rows": [{"gaussians": 100, "seconds": 0.01}]},
            "quality": {
                "official": {
                    "curve": [
                        {"iteration": 50, "seconds": 1.0, "psnr": 19.0, "gaussians": 100},
                        {"iteration": 100, "seconds": 8.0, "psnr": 20.5, "gaussians": 100},
                    ],
                    "peak_mib": 1.0,
                },
                "date": "today",
            },
        },
    }
    first = table.render(results).splitlines()[2]
    assert "40×" in first
    assert "| 400 | 50× |" in first, "1000 iterations of 0.4 s over our 8 s"
    assert "needs torch" in table.render(results)


def test_a_replacement_that_finds_nothing_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "f").write_text("a.cuda()")
    replace_all(tmp_path, {"f": [(".cuda()", "")]})
    assert (tmp_path / "f").read_text() == "a"
    with pytest.raises(Failed, match="another version"):
        replace_all(tmp_path, {"f": [(".cuda()", "")]})
