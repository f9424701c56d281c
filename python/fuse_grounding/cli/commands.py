"""The commands of `fuse`, and what becomes of what goes wrong in them."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from fuse_grounding._core import __version__
from fuse_grounding.arguments import check_simd_level
from fuse_grounding.cli.console import Interrupted
from fuse_grounding.errors import FuseError, InputError

app = typer.Typer(
    name="fuse",
    help="Which object can do it, and where should the camera look next?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

# In the order of `fuse --help`. A module has `app` (a group of commands) or `command` (one).
_COMMANDS = (
    "run",
    "bench",
    "report",
    "episodes",
    "objects",
    "capture",
    "knowledge",
    "splat",
    "collect",
    "train",
    "tune",
    "doctor",
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fuse {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Which object can do it, and where should the camera look next?"""


def _register() -> None:
    for name in _COMMANDS:
        module = importlib.import_module(f"fuse_grounding.cli.{name}")
        if hasattr(module, "app"):
            app.add_typer(module.app, name=name)
        else:
            app.command(name)(module.command)


_register()

# Typer brings its own copy of click in some versions: take the class that it uses.
_UsageError: Any = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


def attempt(arguments: Sequence[str] | None) -> int:
    """Runs the command line; what goes wrong becomes one sentence and an exit status."""
    try:
        check_simd_level()
        status = app(args=None if arguments is None else list(arguments), standalone_mode=False)
        if status == 130:  # what Typer makes of an interrupt
            raise KeyboardInterrupt
        return status if isinstance(status, int) else 0
    except Interrupted as told:
        typer.echo(f"fuse: {told}", err=True)
        return 130
    except InputError as error:
        typer.echo(f"fuse: {error}", err=True)
        return 2
    except FuseError as error:
        typer.echo(f"fuse: {error}", err=True)
        return 1
    except typer.Abort:
        raise KeyboardInterrupt from None
    except typer.Exit as exit_:
        return exit_.exit_code
    except _UsageError as error:
        error.show()
        return 2
    except BrokenPipeError:
        return 1
