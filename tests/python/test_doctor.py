from fuse_grounding import doctor
from fuse_grounding.config import Config


def test_a_missing_file_is_named_with_what_to_do(tmp_path, monkeypatch):
    assert all(c.ok for c in doctor.examine() if c.needed), [c for c in doctor.examine() if not c.ok]
    monkeypatch.setattr(doctor, "PACKAGE", tmp_path)
    missing = {c.name: c for c in doctor.examine() if not c.ok and c.needed}
    assert set(missing) == {"objects", "scenes", "segmenter weights"}
    assert "segmenter.onnx is missing" in missing["segmenter weights"].found
    assert "reinstall" in missing["segmenter weights"].hint


def test_language_models_are_told_without_being_asked(monkeypatch):
    def line(section, **settings):
        checks = {c.name: c for c in doctor.examine(Config().with_(**settings))}
        return checks[f"language model {section}"]

    default = line("vlm")
    assert (default.ok, default.needed, default.found) == (False, False, "no endpoint is configured")
    assert line("vlm", method="vlm").needed
    assert line("knowledge.llm", knowledge={"source": "llm"}).needed
    there = {"base_url": "http://127.0.0.1:9/v1", "model": "m"}  # nobody answers there
    assert line("vlm", vlm={"model": "m"}).found == "vlm.base_url is not set"
    assert line("vlm", vlm=there).found == "`m` at http://127.0.0.1:9/v1, without a key (not called)"
    keyed = {**there, "key_env": "SOME_KEY"}
    assert line("vlm", vlm=keyed).found.endswith("SOME_KEY is not set")
    monkeypatch.setenv("SOME_KEY", "sk-secret")
    told = line("vlm", vlm=keyed)
    assert told.ok
    assert "sk-secret" not in told.found
    assert "offline, from " in line("vlm", vlm={**keyed, "offline": True}).found
