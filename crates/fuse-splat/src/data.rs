//! Posed photographs and a sparse cloud: COLMAP and nerfstudio folders.
//!
//! Files are read and checked before anything is allocated for what they claim. Photos are decoded
//! later, one by one or in parallel, by [`SourceView::read`].

mod colmap;
mod colmap_binary;
mod colmap_text;
mod lens;
mod nerfstudio;
mod photo;

use std::path::{Path, PathBuf};

use fuse_camera::Camera;

use crate::SplatError;
pub use lens::Lens;
pub use photo::Photo;

/// A photo that has not been read yet.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceView {
    /// As the data set calls it; views are sorted by it.
    pub name: String,
    /// The file.
    pub path: PathBuf,
    /// As the data set gives it, before distortion and size are dealt with.
    pub camera: Camera,
    /// The lens's distortion, which [`Self::read`] takes out.
    pub lens: Lens,
}

/// Views and points of a folder.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// `colmap` or `nerfstudio`.
    pub kind: &'static str,
    /// Sorted by name, each name once.
    pub views: Vec<SourceView>,
    /// Positions of the sparse points, world.
    pub xyz: Vec<[f32; 3]>,
    /// Their colours, in [0, 1].
    pub rgb: Vec<[f32; 3]>,
    /// What a user should know: things left out or made up.
    pub notes: Vec<String>,
}

impl Dataset {
    /// Opens a COLMAP folder (`sparse/0`, `sparse`, `colmap/sparse/0` or the folder itself, beside
    /// `images`) or a nerfstudio one (`transforms.json`). Where there are both, COLMAP's is taken.
    ///
    /// # Errors
    /// If the folder has neither, or a file in it is not what it should be; the file is named.
    pub fn open(folder: &Path) -> Result<Self, SplatError> {
        if folder.is_file() && folder.extension().is_some_and(|e| e == "json") {
            let parent = folder.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            return nerfstudio::open(parent, folder)?.checked(folder);
        }
        if !folder.is_dir() {
            return Err(SplatError::file(folder, "not a folder; expected one with COLMAP output or transforms.json"));
        }
        if let Some(model) = colmap::find(folder) {
            return colmap::open(folder, &model)?.checked(&model);
        }
        let json = folder.join("transforms.json");
        if json.is_file() {
            return nerfstudio::open(folder, &json)?.checked(&json);
        }
        Err(SplatError::file(
            folder,
            "neither COLMAP output (sparse/0/cameras.bin or .txt) nor transforms.json was found",
        ))
    }

    /// Sorts the views by name and refuses what nothing can be trained on.
    fn checked(mut self, source: &Path) -> Result<Self, SplatError> {
        if self.views.is_empty() {
            return Err(SplatError::file(source, "no views found, expected at least one posed image"));
        }
        self.views.sort_by(|a, b| a.name.cmp(&b.name));
        if let Some(pair) = self.views.windows(2).find(|w| w[0].name == w[1].name) {
            return Err(SplatError::file(source, format!("image `{}` is listed twice", pair[0].name)));
        }
        let missing: Vec<_> = self.views.iter().filter(|v| !v.path.is_file()).collect();
        if let Some(first) = missing.first() {
            return Err(SplatError::file(
                source,
                format!(
                    "{} of {} images are missing, the first: {}",
                    missing.len(),
                    self.views.len(),
                    first.path.display()
                ),
            ));
        }
        if self.xyz.is_empty() {
            return Err(SplatError::file(source, "no points found; training starts from the sparse points"));
        }
        Ok(self)
    }
}

/// A path inside a folder, from a file that others wrote: relative, and never upward.
fn inside(name: &str) -> Result<PathBuf, String> {
    use std::path::Component;
    let path = Path::new(name);
    // A backslash or a drive would escape on Windows only; refused everywhere alike.
    let plain = path.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if name.is_empty() || !plain || name.contains(['\\', '\0']) || name.get(1..2) == Some(":") {
        return Err(format!("image path `{name}` leaves the data folder, expected a relative path inside it"));
    }
    Ok(path.components().filter(|c| matches!(c, Component::Normal(_))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_inside() {
        assert_eq!(inside("./images/a.png").unwrap(), Path::new("images/a.png"));
        for bad in ["/etc/passwd", "../a.png", "images/../../a.png", "", "C:/a.png", "..\\a.png", "a\0.png"] {
            assert!(inside(bad).unwrap_err().contains("leaves the data folder"), "{bad:?}");
        }
    }
}
