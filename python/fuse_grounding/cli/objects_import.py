"""`fuse objects import`: a user's own models become objects of a library."""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Annotated, Any

import cv2
import typer
from rich.console import Console

from fuse_grounding import _core
from fuse_grounding.cli.console import print_json
from fuse_grounding.errors import InputError
from fuse_grounding.knowledge.affordances import shipped

PIXELS = 256
"""Side of an object's picture."""


def import_(
    files: Annotated[list[Path], typer.Argument(help="Model files: .glb, .gltf or .obj.")],
    category: Annotated[str, typer.Option(help="What they are; one that is not shipped is a new one.")],
    library: Annotated[Path, typer.Option(help="Folder of the library, old or new.")] = Path("library"),
    verbs: Annotated[
        str | None,
        typer.Option(help="What the category is valid for, with commas: cut,scoop.", show_default=False),
    ] = None,
    split: Annotated[str, typer.Option(help="train, dev or eval: scenes that may use them.")] = "eval",
    scale: Annotated[
        float | None, typer.Option(help="Metres of one unit of the files.", show_default="1")
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="Unit of the files instead: m, cm, mm or in.", show_default=False)
    ] = None,
    up: Annotated[
        str | None,
        typer.Option(help="Axis of the files that points up: y or z.", show_default="y for glTF, z for OBJ"),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--id", help="Name of the object.", show_default="the file's")
    ] = None,
    replace: Annotated[bool, typer.Option(help="Replace objects of the same name.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Make objects of your own models: checked, measured, laid to rest, pictured.

    Each file is imported whole or not at all; exit status 2 when one was refused.
    """
    if scale is not None and unit is not None:
        raise InputError("--scale and --unit say the same in two ways; give one of them")
    if name is not None and len(files) > 1:
        raise InputError(f"--id names one object, but there are {len(files)} files")
    metres = _core.unit_metres(unit) if unit is not None else 1.0 if scale is None else scale
    wanted = _verbs(verbs)
    notes = [*_about_category(category), *_about_verbs(wanted)]
    imported: list[dict[str, Any]] = []
    refused: list[dict[str, str]] = []
    for file in files:
        try:
            one = _core.ImportedObject(file, category, split, metres, up, name)
            one.save(library, _png(one), wanted, replace)
        except InputError as error:
            refused.append({"file": str(file), "reason": str(error)})
        else:
            imported.append(one.record())
    if as_json:
        print_json({"library": str(library), "notes": notes, "imported": imported, "refused": refused})
    else:
        _tell(library, notes, imported)
    if refused:
        reasons = "\n  ".join(r["reason"] for r in refused)
        if len(files) == 1:
            raise InputError(reasons)
        raise InputError(f"{len(refused)} of {len(files)} files were refused:\n  {reasons}")


def _verbs(text: str | None) -> list[str]:
    verbs = [v.strip() for v in (text or "").split(",") if v.strip()]
    for verb in verbs:
        if not re.fullmatch(r"[a-z][a-z_]{0,31}", verb):
            raise InputError(f"--verbs: a verb is of lower-case letters and `_`, found {verb!r}")
    return verbs


def _about_category(category: str) -> list[str]:
    known = [name for name, _ in _core.object_categories()]
    if category in known:
        return []
    near = difflib.get_close_matches(category, known, 1, 0.8)
    meant = f"; did you mean {near[0]}?" if near else ""
    return [f"`{category}` is a new category of this library{meant}"]


def _about_verbs(verbs: list[str]) -> list[str]:
    known = list(shipped().verbs)
    return [
        f"verb `{verb}` is not one that the shipped knowledge has ({', '.join(known)})"
        for verb in verbs
        if verb not in known
    ]


def _png(one: _core.ImportedObject) -> bytes:
    written, buffer = cv2.imencode(".png", one.preview(PIXELS)[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not written:
        raise InputError("the picture of the object could not be encoded as PNG")
    return buffer.tobytes()


def _tell(library: Path, notes: list[str], imported: list[dict[str, Any]]) -> None:
    say = Console(soft_wrap=True, highlight=False, markup=False).print
    for note in notes:
        say(f"note: {note}")
    for record in imported:
        found = record["imported"]
        size = " x ".join(f"{100 * s:.1f}" for s in record["size_m"])
        poses = ", ".join(f"{p['probability']:.0%}" for p in record["resting"])
        body = "closed" if found["closed"] else "open"
        say(
            f"{record['id']}: {record['category']}, {size} cm, {found['triangles']} triangles, {body}, "
            f"about {1000 * found['mass_kg']:.0f} g, resting poses {poses}"
        )
        for warning in found["warnings"]:
            say(f"  warning: {warning}")
    if imported:
        say(f"{len(imported)} objects in {library}; fuse objects preview --library {library} shows them")
