//! nerfstudio's `transforms.json` (and instant-ngp's, of the same shape): intrinsics once or for
//! each frame, camera-to-world matrices with OpenGL's axes (x right, y up, z backward).

use std::path::{Path, PathBuf};

use fuse_camera::{Camera, Pinhole, Pose};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng as _;
use serde::Deserialize;

use super::colmap::Points;
use super::{Dataset, Lens, SourceView, inside};
use crate::ply::vertices::Vertices;
use crate::{SplatError, files};

/// Points that are made up where the file names none, as the original does for synthetic scenes.
const RANDOM_POINTS: usize = 20_000;

/// Intrinsics, at the top or in a frame.
#[derive(Clone, Debug, Default, Deserialize)]
struct Intrinsics {
    camera_model: Option<String>,
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    is_fisheye: Option<bool>,
}

#[derive(Debug, Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
}

#[derive(Debug, Deserialize)]
struct File {
    #[serde(flatten)]
    intrinsics: Intrinsics,
    frames: Vec<Frame>,
    ply_file_path: Option<String>,
}

/// Reads `json`, whose paths are relative to `folder`.
pub(super) fn open(folder: &Path, json: &Path) -> Result<Dataset, SplatError> {
    let file = parse(&files::read(json)?).map_err(|what| SplatError::file(json, what))?;
    let mut views = Vec::with_capacity(file.frames.len());
    for (i, frame) in file.frames.iter().enumerate() {
        let at = |e: String| SplatError::file(json, format!("frame {i} (`{}`): {e}", frame.file_path));
        let path = photo(folder, &frame.file_path).map_err(at)?;
        let pose = pose(&frame.transform_matrix).map_err(at)?;
        let (intrinsics, lens) = frame.intrinsics.over(&file.intrinsics).resolve(&path).map_err(at)?;
        views.push(SourceView { name: frame.file_path.clone(), path, camera: Camera { intrinsics, pose }, lens });
    }
    let mut notes = Vec::new();
    let (xyz, rgb) = match &file.ply_file_path {
        Some(name) => {
            let path = folder.join(inside(name).map_err(|e| SplatError::file(json, e))?);
            points(&files::read(&path)?).map_err(|what| SplatError::file(&path, what))?
        }
        None => {
            notes.push(format!(
                "{} names no `ply_file_path`: training starts from {RANDOM_POINTS} random points",
                json.display()
            ));
            random_points(&views)
        }
    };
    Ok(Dataset { kind: "nerfstudio", views, xyz, rgb, notes })
}

fn parse(bytes: &[u8]) -> Result<File, String> {
    let file: File = serde_json::from_slice(bytes).map_err(|e| format!("not the JSON that was expected: {e}"))?;
    if file.frames.is_empty() {
        return Err("`frames` is empty, expected at least one posed image".into());
    }
    Ok(file)
}

/// The photo's file. Synthetic data sets leave out the suffix.
fn photo(folder: &Path, name: &str) -> Result<PathBuf, String> {
    let path = folder.join(inside(name)?);
    if path.is_file() || path.extension().is_some() {
        return Ok(path);
    }
    let candidates = ["png", "jpg", "jpeg"].map(|suffix| path.with_extension(suffix));
    Ok(candidates.into_iter().find(|p| p.is_file()).unwrap_or(path))
}

/// Camera-from-world from a camera-to-world matrix with OpenGL's axes.
fn pose(rows: &[Vec<f64>]) -> Result<Pose, String> {
    if !(3..=4).contains(&rows.len()) || rows.iter().any(|r| r.len() != 4) {
        return Err("transform_matrix must have four rows of four numbers".into());
    }
    if !rows.iter().flatten().all(|v| v.is_finite()) {
        return Err("transform_matrix must be finite".into());
    }
    if let Some(last) = rows.get(3).filter(|r| r[..] != [0.0, 0.0, 0.0, 1.0]) {
        return Err(format!("the last row of transform_matrix is {last:?}, expected [0, 0, 0, 1]"));
    }
    let gl = Matrix3::from_fn(|i, j| rows[i][j]);
    let (skew, determinant) = ((gl.transpose() * gl - Matrix3::identity()).norm(), gl.determinant());
    if skew > 1e-3 || determinant <= 0.0 {
        return Err(format!(
            "transform_matrix is no rigid pose: its rotation has determinant {determinant:.3}, expected 1"
        ));
    }
    // x right, y up, z backward → x right, y down, z forward.
    let axes = gl * Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let center = Vector3::from_fn(|i, _| rows[i][3]);
    let to_world = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&axes));
    let rotation = to_world.inverse();
    Ok(Pose { rotation, translation: -(rotation * center) })
}

impl Intrinsics {
    /// What a frame says, and where it is silent, the top.
    fn over(&self, top: &Self) -> Self {
        let (f, t) = (self.clone(), top.clone());
        Self {
            camera_model: f.camera_model.or(t.camera_model),
            w: f.w.or(t.w),
            h: f.h.or(t.h),
            fl_x: f.fl_x.or(t.fl_x),
            fl_y: f.fl_y.or(t.fl_y),
            cx: f.cx.or(t.cx),
            cy: f.cy.or(t.cy),
            camera_angle_x: f.camera_angle_x.or(t.camera_angle_x),
            camera_angle_y: f.camera_angle_y.or(t.camera_angle_y),
            k1: f.k1.or(t.k1),
            k2: f.k2.or(t.k2),
            k3: f.k3.or(t.k3),
            k4: f.k4.or(t.k4),
            p1: f.p1.or(t.p1),
            p2: f.p2.or(t.p2),
            is_fisheye: f.is_fisheye.or(t.is_fisheye),
        }
    }

    /// Pinhole and lens; the size is the photo's own where the file does not say.
    fn resolve(&self, path: &Path) -> Result<(Pinhole, Lens), String> {
        let model = self.camera_model.as_deref().unwrap_or("OPENCV");
        let perspective = ["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"];
        if !perspective.contains(&model) || self.is_fisheye == Some(true) || self.k4.is_some_and(|k| k != 0.0) {
            let found = if perspective.contains(&model) { "a fisheye lens or k4" } else { model };
            return Err(format!(
                "camera_model {found} is not supported, expected one of {}; undistort the images first",
                perspective.join(", ")
            ));
        }
        let k = |v: Option<f64>| v.unwrap_or(0.0);
        let lens = Lens { k: [k(self.k1), k(self.k2), k(self.k3), 0.0, 0.0, 0.0], p: [k(self.p1), k(self.p2)] };
        lens.check()?;
        let (width, height) = match (self.w, self.h) {
            (Some(w), Some(h)) => (side("w", w)?, side("h", h)?),
            _ => {
                image::image_dimensions(path).map_err(|e| format!("the size of {} is unknown: {e}", path.display()))?
            }
        };
        let focal = |length: Option<f64>, angle: Option<f64>, pixels: u32| {
            length.or_else(|| angle.map(|a| f64::from(pixels) / (2.0 * (a / 2.0).tan())))
        };
        let fx = focal(self.fl_x, self.camera_angle_x, width).ok_or("neither `fl_x` nor `camera_angle_x` is given")?;
        let fy = focal(self.fl_y, self.camera_angle_y, height).unwrap_or(fx);
        let (cx, cy) = (self.cx.unwrap_or(f64::from(width) / 2.0), self.cy.unwrap_or(f64::from(height) / 2.0));
        let pinhole = Pinhole::new(width, height, fx, fy, cx, cy).map_err(|e| e.to_string())?;
        Ok((pinhole, lens))
    }
}

/// Sizes are written as floats by some tools.
fn side(name: &str, value: f64) -> Result<u32, String> {
    if value.fract() != 0.0 || !(1.0..=16384.0).contains(&value) {
        return Err(format!("`{name}` is {value}, expected a whole number of pixels"));
    }
    Ok(value as u32)
}

/// A PLY of coloured points.
fn points(bytes: &[u8]) -> Result<Points, String> {
    let vertices = Vertices::parse(bytes)?;
    let colored = vertices.has("red");
    let names = ["x", "y", "z", "red", "green", "blue"].map(String::from);
    let wanted = if colored { &names[..] } else { &names[..3] };
    let rows = vertices.read(wanted, "", "points with x, y, z, and red, green, blue where there is one of them")?;
    let xyz = rows.iter().map(|r| [r[0], r[1], r[2]]).collect();
    let grey = |v: f32| (v / 255.0).clamp(0.0, 1.0);
    let rgb = rows.iter().map(|r| if colored { [r[3], r[4], r[5]].map(grey) } else { [0.5; 3] }).collect();
    Ok((xyz, rgb))
}

/// Grey points in a cube around what the cameras look at: the point nearest to all optical axes, as
/// far as the farthest camera. The same views give the same points.
fn random_points(views: &[SourceView]) -> Points {
    let centers: Vec<Vector3<f64>> = views.iter().map(|v| v.camera.pose.center().coords).collect();
    let mean = centers.iter().sum::<Vector3<f64>>() / centers.len().max(1) as f64;
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for (view, center) in views.iter().zip(&centers) {
        let axis = view.camera.pose.rotation.inverse() * Vector3::z();
        let across = Matrix3::identity() - axis * axis.transpose();
        a += across;
        b += across * center;
    }
    // Parallel axes meet nowhere: the cameras' mean then, as wide as they are spread.
    let middle = if a.determinant() > 1e-6 { a.try_inverse().map_or(mean, |i| i * b) } else { mean };
    let reach = centers.iter().map(|c| (c - middle).norm()).fold(0.0, f64::max).max(1e-3);
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut point = || std::array::from_fn(|k| (middle[k] + reach * (2.0 * rng.random::<f64>() - 1.0)) as f32);
    ((0..RANDOM_POINTS).map(|_| point()).collect(), vec![[0.5; 3]; RANDOM_POINTS])
}
