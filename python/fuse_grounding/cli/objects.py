"""`fuse objects`: generate the catalogue, import models, list them, look at them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from fuse_grounding import _core
from fuse_grounding.cli.console import print_json
from fuse_grounding.cli.objects_import import import_
from fuse_grounding.errors import InputError

SHIPPED = Path(__file__).parent.parent / "data" / "objects"

app = typer.Typer(help="The objects that scenes are made of.", no_args_is_help=True)
app.command("import")(import_)

Library = Annotated[Path, typer.Option("--library", help="Folder with catalogue.json.")]
Categories = Annotated[
    list[str] | None, typer.Option("--category", help="Only this category. Repeatable.", show_default=False)
]


@app.command()
def generate(
    out: Annotated[Path, typer.Option(help="New or empty folder.")],
    category: Categories = None,
) -> None:
    """Generate the shipped catalogue from its seeds: the same bytes every time."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"--out {out} exists and is not an empty folder")
    part = out.with_name(out.name + ".part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        ids = _core.write_objects(str(part), category)
        if out.exists():
            out.rmdir()
        part.rename(out)
    except OSError as error:
        raise InputError(f"cannot write --out {out}: {error.strerror}") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
    megabytes = sum(f.stat().st_size for f in out.iterdir()) / 1e6
    Console(soft_wrap=True, highlight=False).print(f"{len(ids)} objects, {megabytes:.1f} MB, in {out}")


def _chosen(library: Path, category: list[str] | None) -> tuple[_core.ObjectCatalogue, list[dict[str, Any]]]:
    catalogue = _core.ObjectCatalogue(str(library))
    records = catalogue.records()
    known = sorted({r["category"] for r in records})
    for name in category or []:
        if name not in known:
            raise InputError(
                f"no object of category {name} in {library}, expected one of: {', '.join(known)}"
            )
    return catalogue, [r for r in records if not category or r["category"] in category]


@app.command(name="list")
def list_(
    library: Library = SHIPPED,
    category: Categories = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """List the objects with size and resting poses; --json tells all that is recorded."""
    _, records = _chosen(library, category)
    if as_json:
        print_json(records)
        return
    table = Table("object", "category", "split", "size in cm", "resting poses", box=None)
    for r in records:
        size = " x ".join(f"{100 * s:.1f}" for s in r["size_m"])
        poses = ", ".join(f"{p['probability']:.0%}" for p in r["resting"])
        table.add_row(r["id"], r["category"], r["split"], size, poses)
    Console().print(table)


@app.command()
def preview(
    out: Annotated[Path, typer.Option(help="PNG file to write.")] = Path("objects.png"),
    library: Library = SHIPPED,
    category: Categories = None,
    pixels: Annotated[int, typer.Option(min=48, max=512, help="Side of each picture.")] = 160,
    sheets: Annotated[
        Path | None,
        typer.Option(
            help="Folder for a PNG per category instead: all its objects from above, and as the camera sees "
            "them from its lower pitch.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Draw a contact sheet: a row for each category, all its objects, by name."""
    catalogue, records = _chosen(library, category)
    rows: dict[str, list[dict[str, Any]]] = {}
    for record in records:
        rows.setdefault(record["category"], []).append(record)
    say = Console(soft_wrap=True, highlight=False).print
    if sheets is not None:
        try:
            sheets.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--sheets {sheets} cannot be made: {error.strerror}") from None
        for name, row in rows.items():
            _write_picture("--sheets", sheets / f"{name}.png", _two_views(catalogue, row, pixels))
        say(f"{len(records)} objects on {len(rows)} sheets in {sheets}")
        return
    longest = max(map(len, rows.values()))
    blank = np.full((pixels + 16, pixels, 3), 255, np.uint8)
    strips = []
    for name, row in rows.items():
        pictures = [
            _captioned(catalogue.preview(r["id"], pixels, _turn(k)), _short(r)) for k, r in enumerate(row)
        ]
        strips.append(np.hstack([_name(name, pixels), *pictures, *[blank] * (longest - len(row))]))
    _write_picture("--out", out, np.vstack(strips))
    say(f"{len(records)} objects in {out}")


ABOVE, PITCH = 62.0, 30.0
"""How far the camera looks down on a sheet, degrees: to show a shape, and as in episodes at their lowest."""


def _two_views(catalogue: _core.ObjectCatalogue, row: list[dict[str, Any]], pixels: int) -> NDArray[np.uint8]:
    """Objects side by side, from above and under them from the pitch of episodes."""
    above = [catalogue.preview(r["id"], pixels, 0.5, 0, ABOVE) for r in row]
    across = [
        _captioned(catalogue.preview(r["id"], pixels, _turn(k), 0, PITCH), _short(r))
        for k, r in enumerate(row)
    ]
    # Five bits a channel: half the size of the file, and nobody sees it.
    return np.vstack([np.hstack(above), np.hstack(across)]) & np.uint8(0xF8)


def _turn(k: int) -> float:
    """Heading of the k-th object of a row, radians: every side of a category is seen."""
    return 0.5 + 0.8 * k


def _short(record: dict[str, Any]) -> str:
    return str(record["id"]).removeprefix(record["category"] + "_")


def _write_picture(option: str, path: Path, picture: NDArray[np.uint8]) -> None:
    written, buffer = cv2.imencode(".png", picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not written:
        raise InputError("the contact sheet could not be encoded as PNG")
    try:
        path.write_bytes(buffer.tobytes())
    except OSError as error:
        raise InputError(f"cannot write {option} {path}: {error.strerror}") from None


def _captioned(picture: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    strip = np.full((16, picture.shape[1], 3), 255, np.uint8)
    cv2.putText(strip, text, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([picture, strip])


def _name(category: str, pixels: int) -> NDArray[np.uint8]:
    cell = np.full((pixels + 16, 130, 3), 255, np.uint8)
    label = dict(_core.object_categories()).get(category, category)
    cv2.putText(cell, label, (6, pixels // 2), cv2.FONT_HERSHEY_SIMPLEX, 0.48, (0, 0, 0), 1, cv2.LINE_AA)
    return cell
