//! COLMAP's sparse models: where they lie, and how their three files become views and points.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use fuse_camera::{Camera, Pinhole, Pose};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::{Dataset, Lens, SourceView, colmap_binary, colmap_text, inside};
use crate::{SplatError, files};

/// An image of a model.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ImageRecord {
    pub name: String,
    pub camera: u32,
    pub pose: Pose,
}

pub(super) type Cameras = HashMap<u32, (Pinhole, Lens)>;
/// Positions and colours.
pub(super) type Points = (Vec<[f32; 3]>, Vec<[f32; 3]>);

/// The folder of the model, and whether it is binary.
#[derive(Debug)]
pub(super) struct Place {
    folder: PathBuf,
    binary: bool,
}

impl std::ops::Deref for Place {
    type Target = Path;
    fn deref(&self) -> &Path {
        &self.folder
    }
}

/// The first place that has a model, binary before text.
pub(super) fn find(folder: &Path) -> Option<Place> {
    ["sparse/0", "sparse", "colmap/sparse/0", ""].iter().find_map(|sub| {
        let folder = if sub.is_empty() { folder.to_path_buf() } else { folder.join(sub) };
        let has = |name: &str| folder.join(name).is_file();
        let binary = has("cameras.bin");
        (binary || has("cameras.txt")).then_some(Place { folder, binary })
    })
}

/// Reads a model; photos are in `images` beside it, or in the folder itself.
pub(super) fn open(folder: &Path, place: &Place) -> Result<Dataset, SplatError> {
    let suffix = if place.binary { "bin" } else { "txt" };
    let file = |name: &str| place.folder.join(format!("{name}.{suffix}"));
    let cameras = parse(&file("cameras"), if place.binary { colmap_binary::cameras } else { colmap_text::cameras })?;
    let images = parse(&file("images"), if place.binary { colmap_binary::images } else { colmap_text::images })?;
    let (xyz, rgb) = parse(&file("points3D"), if place.binary { colmap_binary::points } else { colmap_text::points })?;
    if xyz.is_empty() {
        return Err(SplatError::file(&file("points3D"), "no points found; training starts from the sparse points"));
    }
    let photos = folder.join("images");
    let photos = if photos.is_dir() { photos } else { folder.to_path_buf() };
    let view = |image: ImageRecord| {
        let (intrinsics, lens) = cameras.get(&image.camera).ok_or_else(|| {
            format!("image `{}` has camera {}, which cameras.{suffix} lacks", image.name, image.camera)
        })?;
        let path = photos.join(inside(&image.name)?);
        Ok(SourceView {
            path,
            name: image.name,
            camera: Camera { intrinsics: *intrinsics, pose: image.pose },
            lens: *lens,
        })
    };
    let views = images
        .into_iter()
        .map(|image| view(image).map_err(|what: String| SplatError::file(&file("images"), what)))
        .collect::<Result<_, _>>()?;
    Ok(Dataset { kind: "colmap", views, xyz, rgb, notes: Vec::new() })
}

fn parse<T>(path: &Path, read: impl Fn(&[u8]) -> Result<T, String>) -> Result<T, SplatError> {
    read(&files::read(path)?).map_err(|what| SplatError::file(path, what))
}

/// A pose from a quaternion (w, x, y, z) of about unit length, and a translation.
pub(super) fn pose([w, x, y, z]: [f64; 4], translation: [f64; 3]) -> Result<Pose, String> {
    let q = Quaternion::new(w, x, y, z);
    let length = q.norm();
    // Comparisons are false for NaN.
    if !(0.9..1.1).contains(&length) {
        return Err(format!("its quaternion has length {length}, expected 1"));
    }
    if !translation.iter().all(|v| v.is_finite()) {
        return Err(format!("its translation is {translation:?}, expected finite numbers"));
    }
    Ok(Pose { rotation: UnitQuaternion::from_quaternion(q), translation: Vector3::from(translation) })
}

/// A point's position, refused where it is not finite.
pub(super) fn position(xyz: [f64; 3]) -> Result<[f32; 3], String> {
    let p = xyz.map(|v| v as f32);
    if !p.iter().all(|v| v.is_finite()) {
        return Err(format!("it lies at {xyz:?}, expected finite numbers"));
    }
    Ok(p)
}

/// A camera added under its number.
pub(super) fn add_camera(
    cameras: &mut Cameras,
    id: u32,
    model: &str,
    [width, height]: [u64; 2],
    params: &[f64],
) -> Result<(), String> {
    let camera = super::lens::camera(model, width, height, params).map_err(|e| format!("camera {id}: {e}"))?;
    match cameras.insert(id, camera) {
        None => Ok(()),
        Some(_) => Err(format!("camera {id} is there twice")),
    }
}
