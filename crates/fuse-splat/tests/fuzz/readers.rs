//! What a reader may do with a file, whatever is in it: take it, and then all of it makes sense, or
//! refuse it with a sentence. Shared by `fuzz_readers.rs` and the targets of `fuzz/`.

use std::path::{Path, PathBuf};

use fuse_splat::data::Dataset;
use fuse_splat::{Gaussians, SplatError};

/// A map.
pub fn ply(path: &Path) -> Result<(), SplatError> {
    Gaussians::from_ply(path).map(|g| assert_finite(&g))
}

/// A map.
pub fn spz(path: &Path) -> Result<(), SplatError> {
    Gaussians::from_spz(path).map(|g| assert_finite(&g))
}

fn assert_finite(g: &Gaussians) {
    assert!((0..g.len()).all(|i| g.vector(i).iter().all(|v| v.is_finite())), "a value that is not finite got in");
}

/// A folder of posed photos.
pub fn photo_set(folder: &Path) -> Result<(), SplatError> {
    let set = Dataset::open(folder)?;
    let finite = set.xyz.iter().chain(&set.rgb).flatten().all(|v| v.is_finite());
    assert!(finite && !set.views.is_empty() && set.xyz.len() == set.rgb.len());
    for view in &set.views {
        assert!(view.path.starts_with(folder), "{} is elsewhere", view.path.display());
        // Its errors are fine too.
        let _ = view.camera_at(1);
    }
    Ok(())
}

/// Where a file of a corpus of photo sets stands in its set: `NAME-what.txt` for `NAME.txt`.
pub fn place(reader: &str, folder: &Path, file: &str) -> PathBuf {
    if reader == "nerfstudio" {
        return folder.join("transforms.json");
    }
    let (name, suffix) = if reader == "colmap_text" { (file, "txt") } else { (file, "bin") };
    let name = name.split(['-', '.']).next().unwrap_or(name);
    folder.join("sparse/0").join(format!("{name}.{suffix}"))
}

pub fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() { copy(&path, &target) } else { std::fs::copy(&path, &target).map(|_| ()).unwrap() }
    }
}
