"""`fuse report`: benchmark folders become one page, Markdown, LaTeX and CSV (docs/report.md)."""

from fuse_grounding.benchmark.report.build import Options, build
from fuse_grounding.benchmark.report.files import write
from fuse_grounding.benchmark.report.load import Results, load

__all__ = ["Options", "Results", "build", "load", "write"]
