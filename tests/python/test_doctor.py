from fuse_grounding import doctor


def test_a_missing_file_is_named_with_what_to_do(tmp_path, monkeypatch):
    assert all(c.ok for c in doctor.examine() if c.needed), [c for c in doctor.examine() if not c.ok]
    monkeypatch.setattr(doctor, "PACKAGE", tmp_path)
    missing = {c.name: c for c in doctor.examine() if not c.ok and c.needed}
    assert set(missing) == {"objects", "scenes", "segmenter weights"}
    assert "segmenter.onnx is missing" in missing["segmenter weights"].found
    assert "reinstall" in missing["segmenter weights"].hint
