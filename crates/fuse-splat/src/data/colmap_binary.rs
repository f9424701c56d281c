//! COLMAP's binary files: little-endian records after a 64-bit count.

use super::colmap::{Cameras, ImageRecord, Points, add_camera, pose, position};
use super::lens::model_by_number;
use crate::bytes::Bytes;

/// cameras.bin: number, model, width, height, parameters.
pub(super) fn cameras(bytes: &[u8]) -> Result<Cameras, String> {
    let mut b = Bytes::new(bytes);
    let mut cameras = Cameras::new();
    for i in 0..b.count(24, "cameras")? {
        let what = format!("camera record {i}");
        let id = b.u32(&what)?;
        let number = i32::from_le_bytes(b.u32(&what)?.to_le_bytes());
        let (model, count) = model_by_number(number).map_err(|e| format!("camera {id}: {e}"))?;
        let size = [b.u64(&what)?, b.u64(&what)?];
        let params = (0..count).map(|_| b.f64(&what)).collect::<Result<Vec<_>, _>>()?;
        add_camera(&mut cameras, id, model, size, &params)?;
    }
    finish(&b, "cameras")?;
    Ok(cameras)
}

/// images.bin: number, quaternion, translation, camera, name, observed points.
pub(super) fn images(bytes: &[u8]) -> Result<Vec<ImageRecord>, String> {
    let mut b = Bytes::new(bytes);
    let count = b.count(73, "images")?;
    let mut images = Vec::with_capacity(count);
    for i in 0..count {
        let what = format!("image record {i}");
        let id = b.u32(&what)?;
        let (rotation, translation) = (b.f64s(&what)?, b.f64s(&what)?);
        let camera = b.u32(&what)?;
        let name = b.text(&what)?.to_owned();
        let pose = pose(rotation, translation).map_err(|e| format!("image {id} (`{name}`): {e}"))?;
        let observed = b.count(24, "observations")?;
        b.take(24 * observed, &what)?;
        images.push(ImageRecord { name, camera, pose });
    }
    finish(&b, "images")?;
    Ok(images)
}

/// points3D.bin: number, position, colour, error, track.
pub(super) fn points(bytes: &[u8]) -> Result<Points, String> {
    let mut b = Bytes::new(bytes);
    let count = b.count(51, "points")?;
    let (mut xyz, mut rgb) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for i in 0..count {
        let what = format!("point record {i}");
        let id = b.u64(&what)?;
        xyz.push(position(b.f64s(&what)?).map_err(|e| format!("point {id}: {e}"))?);
        let color = b.take(3, &what)?;
        rgb.push([color[0], color[1], color[2]].map(|v| f32::from(v) / 255.0));
        b.f64(&what)?;
        let track = b.count(8, "track elements")?;
        b.take(8 * track, &what)?;
    }
    finish(&b, "points")?;
    Ok((xyz, rgb))
}

fn finish(b: &Bytes<'_>, what: &str) -> Result<(), String> {
    match b.left() {
        0 => Ok(()),
        n => Err(format!("{n} bytes follow the last of the {what}")),
    }
}
