"""The page of a report: self-contained, well-formed, and the same for people with any window."""

from __future__ import annotations

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from browser import Browser, find
from report_folders import write_folder

from fuse_grounding.benchmark.report import Options, build, load, write
from fuse_grounding.benchmark.report.model import Gallery, Strip, Text
from fuse_grounding.config import Config
from fuse_grounding.environment import load_episodes
from fuse_grounding.record import EpisodeRecord, ResultEntry, StepEntry, ViewEntry

pytest.importorskip("scipy", reason="the statistics of a report need the extra `report`")
pytest.importorskip("statsmodels", reason="the statistics of a report need the extra `report`")

PICTURES = ("observation", "semantic", "geometric", "evidence")


def keep_episode(folder: Path, method: str, episode: str, steps: int = 3) -> Path:
    """What `fuse bench --gallery` keeps of one episode, with noise for pictures."""
    place = folder / "gallery" / method / episode
    entries = []
    for k in range(steps):
        pictures = place / "steps" / f"{k:02d}"
        pictures.mkdir(parents=True)
        for name in PICTURES:
            noise = np.random.default_rng(k).integers(0, 255, (480, 640, 3), np.uint8)
            cv2.imwrite(str(pictures / f"{name}.png"), noise)
        last = k == steps - 1
        entries.append(
            StepEntry(
                index=k,
                node=k,
                pitch_deg=30.0,
                registration="posed",
                scores=[],
                best_score=0.5,
                improved=k == 0,
                branch=None if last else "explicit",
                entropy=None if last else 0.85,
                action=None if last else 8,
                reason="<b>uncertain</b>",
            )
        )
    result = ResultEntry(
        status="not_found",
        stop_reason="patience",
        label=None,
        fused_label=None,
        score=None,
        instance_score=None,
        view=ViewEntry(index=0, node=0, pitch_deg=30.0, center_m=None),
        centroid_m=None,
        box_m=None,
        mask=None,
        online_actions=steps - 1,
        observations=steps,
        seed_motions=0,
        total_steps=steps - 1,
        branches={},
        registrations={},
        planner=None,
        timings={},
        wall_seconds=1.0,
    )
    EpisodeRecord(
        query="cut </script> a rope",
        verb="cut",
        because="cut",
        method=method,
        knowledge="graph",
        candidates=[],
        announcements=[],
        config=Config().to_dict(),
        provenance={},
        steps=entries,
        result=result,
    ).write(place / "episode.json")
    return place


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every method, an error, something that was not run, two episodes with pictures."""
    episodes = load_episodes("dev")[:12]
    methods = [
        "static",
        "random",
        "sweep",
        "semantic_only",
        "geometry_only",
        "explicit",
        "amortized",
        "fuse",
        "fuse_oracle",
    ]
    made = write_folder(
        tmp_path_factory.mktemp("page") / "b",
        methods,
        episodes,
        errors=[("fuse", "dev_0001")],
        not_run=[("vlm", "no endpoint of a hosted model")],
    )
    keep_episode(made, "explicit", "dev_0000")
    keep_episode(made, "fuse", "dev_0001", steps=2)
    return made


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    return write(build(load([folder])), folder / "report")[0]


class Elements(HTMLParser):
    """Checks that elements close in order; collects attributes that load something."""

    VOID = frozenset({"meta", "img", "br", "wbr", "input", "link"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.images_without_words = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.loaded += [v or "" for k, v in attrs if k in ("src", "srcset", "action", "data", "poster")]
        self.ids += [v for k, v in attrs if k == "id" and v]
        if tag in ("a", "link", "use"):
            self.links.append(values.get("href") or "")
        self.images_without_words += tag == "img" and not values.get("alt")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open, f"</{tag}> closes nothing"
            assert self.open.pop() == tag, f"</{tag}> is out of order"


def test_the_page_is_well_formed_and_loads_nothing(page: Path):
    text = page.read_text()
    elements = Elements()
    elements.feed(text)
    assert elements.open == []
    assert elements.loaded, "the gallery has pictures"
    assert all(source.startswith("data:image/webp;base64,") for source in elements.loaded)
    assert all(link.startswith("#") and link[1:] in elements.ids for link in elements.links)
    assert len(set(elements.ids)) == len(elements.ids)
    assert elements.images_without_words == 0
    assert "default-src 'none'" in text
    assert "http:" not in text
    assert "https:" not in text
    assert "@import" not in text
    assert "url(" not in text


def test_words_of_others_are_text_and_never_markup(page: Path):
    text = page.read_text()
    assert "cut &lt;/script&gt; a rope" in text
    assert "&lt;b&gt;uncertain&lt;/b&gt;" in text
    assert "the map came apart &lt;at step 3&gt; &amp; more_of_it" in text
    assert text.count("</script>") == 1


def test_a_gallery_stays_under_its_limit_and_says_what_is_cut(folder: Path):
    def gallery(limit: float) -> tuple[list[Strip], list[str]]:
        report = build(load([folder]), Options(gallery_mb=limit))
        blocks = next(s.blocks for s in report.sections if s.name == "gallery")
        strips = [strip for b in blocks if isinstance(b, Gallery) for strip in b.strips]
        return strips, [b.words for b in blocks if isinstance(b, Text)]

    whole, words = gallery(16)
    assert [(s.method, s.episode) for s in whole] == [
        ("Explicit Exploration", "dev_0000"),
        ("FUSE", "dev_0001"),
    ]
    assert words == []
    first = sum(len(p.uri) for frame in whole[0].frames for p in frame.pictures) / 1e6
    cut, words = gallery(first)
    assert cut == whole[:1]
    assert words == [
        "1 of 2 recorded episodes are left out, so that the pictures stay under "
        f"{first:g} MB; `--gallery-mb` raises the limit."
    ]
    assert gallery(first - 1e-3)[0] == []


def test_an_episode_that_cannot_be_read_is_named_and_the_others_are_shown(tmp_path: Path):
    made = write_folder(tmp_path / "b", ["static"])
    whole, picture, record = (keep_episode(made, "static", f"dev_000{k}", steps=1) for k in range(3))
    (picture / "steps/00/semantic.png").write_bytes(b"no picture")
    (record / "episode.json").write_text('{"schema_version": 1, "steps"')
    report = build(load([made]))
    blocks = next(s.blocks for s in report.sections if s.name == "gallery")
    assert [s.episode for b in blocks if isinstance(b, Gallery) for s in b.strips] == [whole.name]
    said = [b.words for b in blocks if isinstance(b, Text) and b.kind == "warning"]
    assert said[0] == "Cannot be shown: b/gallery/static/dev_0001/steps/00/semantic.png is not a picture."
    assert said[1].startswith(
        "Cannot be shown: episode record b/gallery/static/dev_0002/episode.json is not "
    )


# -- in a browser ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    program = find()
    if program is None:
        pytest.skip("no Chromium on the path (Debian: chromium or chromium-headless-shell)")
    with Browser(program, tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [390, 1440])
def test_nothing_overflows_fails_or_asks_for_anything(browser: Browser, page: Path, width: int, dark: bool):
    browser.open(page, width, dark=dark)
    browser.run("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    assert browser.run("document.documentElement.scrollWidth") <= width
    sticking_out = browser.run(
        """[...document.querySelectorAll("main *")].filter((e) => !e.closest(".scroll") && !e.closest("svg")
            && e.getBoundingClientRect().right > innerWidth + 1).map((e) => e.tagName + "." + e.className)"""
    )
    assert sticking_out == []
    asked = [
        e["params"]["request"]["url"]
        for e in browser.events
        if e.get("method") == "Network.requestWillBeSent"
    ]
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert len([url for url in asked if url.startswith("file:")]) == 1
    wrong = [e for e in browser.events if e.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded")]
    assert wrong == []
    dim, light = browser.run(
        """["--paper", "--ink"].map((name) => {
            const probe = document.body.appendChild(document.createElement("i"));
            probe.style.color = `var(${name})`;
            const [r, g, b] = getComputedStyle(probe).color.match(/[0-9]+/g).map(Number);
            probe.remove();
            return r + g + b; })"""
    )
    assert (dim < light) == dark
    assert (
        browser.run(
            """Promise.all([...document.images].map((image) => {
            image.loading = "eager";  // what is folded away waits otherwise
            return image.decode().then(() => image.naturalWidth); }))"""
        )
        == [320] * 20
    )


def test_plots_fill_their_figures_and_have_the_pages_colours(browser: Browser, page: Path):
    browser.open(page, 390)
    sizes = browser.run(
        """[...document.querySelectorAll("svg.plot")]
            .map((plot) => [plot.clientWidth, plot.closest("figure").clientWidth])"""
    )
    assert len(sizes) == 9
    assert all(0.9 * outer <= inner <= outer for inner, outer in sizes)
    colour = "getComputedStyle(document.querySelector('.plot .line.s8')).stroke"
    light = browser.run(colour)
    browser.open(page, 390, dark=True)
    assert light != browser.run(colour)


def test_tables_sort_by_any_column_both_ways(browser: Browser, page: Path):
    browser.open(page, 1440)
    names = "[...document.querySelectorAll('#dev_main tbody tr')].map((r) => r.cells[0].textContent)"
    rows = "[...document.querySelectorAll('#dev_main tbody tr:not(.noted)')]"
    heads = browser.run("[...document.querySelectorAll('#dev_main thead th')].map((h) => h.innerText)")
    column = next(i for i, head in enumerate(heads) if head.startswith("Success"))
    values = f"{rows}.map((r) => Number(r.cells[{column}].dataset.v))"
    click = f"document.querySelectorAll('#dev_main thead th')[{column}].querySelector('button').click()"
    before = browser.run(names)
    browser.run(click)
    rising = browser.run(values)
    assert rising == sorted(rising)
    assert len(set(rising)) > 2
    assert browser.run(names)[-1] == before[-1] == "VLM Active"
    browser.run(click)
    falling = browser.run(values)
    assert falling == sorted(falling, reverse=True)
    state = f"document.querySelectorAll('#dev_main thead th')[{column}].getAttribute('aria-sort')"
    assert browser.run(state) == "descending"
    assert browser.run(names)[-1] == "VLM Active"
    browser.run("document.querySelector('#dev_main thead th button').click()")
    words = browser.run(names)[:-1]
    assert words == sorted(words, key=str.lower)


def test_an_episode_is_stepped_through_by_button_and_key(browser: Browser, page: Path):
    browser.open(page, 1440)
    shown = "[...document.querySelectorAll('.strip')[0].querySelectorAll('.frame')].map((f) => !f.hidden)"
    browser.run("document.querySelector('.strip').open = true")
    assert browser.run(shown) == [True, False, False]
    browser.run("document.querySelectorAll('.strip .stepper button')[1].click()")
    assert browser.run(shown) == [False, True, False]
    browser.run(
        """document.querySelector('.strip summary').dispatchEvent(
            new KeyboardEvent('keydown', {key: 'ArrowRight', bubbles: true}))"""
    )
    assert browser.run(shown) == [False, False, True]
    assert browser.run("document.querySelectorAll('.strip .stepper button')[1].disabled")


def test_without_scripts_everything_is_there(browser: Browser, page: Path):
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(page, 1440)
        assert browser.run("document.querySelectorAll('thead button').length") == 0
        assert browser.run("document.querySelectorAll('.frame[hidden]').length") == 0
        assert browser.run("document.querySelectorAll('#dev_main tbody tr').length") == 10
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
