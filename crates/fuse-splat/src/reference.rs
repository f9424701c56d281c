//! The slow, obvious renderer and loss, in double precision: no tiles, no lists, no vectors, and
//! none of the code that it judges. For tests.

use fuse_camera::{Camera, RgbBuffer};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Quaternion, UnitQuaternion, Vector2, Vector3};

use crate::constants::PARAMETERS;

/// A Gaussian on the image plane.
struct Flat {
    mean: Vector2<f64>,
    conic: Matrix2<f64>,
    opacity: f64,
    color: [f64; 3],
    depth: f64,
}

/// Colour (three a pixel), transmittance and Σ wᵢ zᵢ, row-major.
pub struct Picture {
    /// Red, green, blue of each pixel.
    pub color: Vec<[f64; 3]>,
    /// What each pixel lets through.
    pub transmittance: Vec<f64>,
    /// Weighted sum of depths, metres.
    pub depth: Vec<f64>,
}

fn harmonics(d: Vector3<f64>, degree: u32) -> Vec<f64> {
    let (x, y, z) = (d.x, d.y, d.z);
    let all = [
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2.0 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3.0 * x * x - y * y),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4.0 * z * z - x * x - y * y),
        0.3731763325901154 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y),
        -0.4570457994644658 * x * (4.0 * z * z - x * x - y * y),
        1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3.0 * y * y),
    ];
    all[..((degree + 1) * (degree + 1)) as usize].to_vec()
}

fn flatten(v: &[f64; PARAMETERS], camera: &Camera, degree: u32) -> Option<Flat> {
    let k = &camera.intrinsics;
    let position = Vector3::new(v[0], v[1], v[2]);
    let w = camera.pose.rotation.to_rotation_matrix().into_inner();
    let t = w * position + camera.pose.translation;
    if t.z <= 0.2 {
        return None;
    }
    let scale = Matrix3::from_diagonal(&Vector3::new(v[3].exp(), v[4].exp(), v[5].exp()));
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(v[6], v[7], v[8], v[9])).to_rotation_matrix();
    let covariance = rotation * scale * scale * rotation.transpose();
    let limit = Vector2::new(1.3 * f64::from(k.width) / (2.0 * k.fx), 1.3 * f64::from(k.height) / (2.0 * k.fy));
    let u = Vector2::new((t.x / t.z).clamp(-limit.x, limit.x), (t.y / t.z).clamp(-limit.y, limit.y));
    let j = Matrix2x3::new(k.fx / t.z, 0.0, -k.fx * u.x / t.z, 0.0, k.fy / t.z, -k.fy * u.y / t.z);
    let flat = j * w * covariance * w.transpose() * j.transpose() + Matrix2::identity() * 0.3;
    let direction = (position - camera.pose.center().coords).normalize();
    let y = harmonics(direction, degree);
    let color = [0, 1, 2].map(|c| {
        let rest: f64 = (1..y.len()).map(|i| v[14 + 15 * c + i - 1] * y[i]).sum();
        (0.5 + v[11 + c] * y[0] + rest).max(0.0)
    });
    Some(Flat {
        mean: Vector2::new(k.fx * t.x / t.z + k.cx, k.fy * t.y / t.z + k.cy),
        conic: flat.try_inverse()?,
        opacity: 1.0 / (1.0 + (-v[10]).exp()),
        color,
        depth: t.z,
    })
}

/// Draws Gaussians of 59 numbers each, by the original's rules, pixel by pixel.
pub fn render(gaussians: &[[f64; PARAMETERS]], camera: &Camera, degree: u32, background: [f64; 3]) -> Picture {
    let mut flats: Vec<Flat> = gaussians.iter().filter_map(|v| flatten(v, camera, degree)).collect();
    flats.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut picture = Picture { color: Vec::new(), transmittance: Vec::new(), depth: Vec::new() };
    for i in 0..width * height {
        let pixel = Vector2::new(f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
        let (mut color, mut t, mut depth) = ([0.0; 3], 1.0, 0.0);
        for f in &flats {
            let d = pixel - f.mean;
            let alpha = (f.opacity * (-0.5 * (d.transpose() * f.conic * d).x).exp()).min(0.99);
            if alpha < 1.0 / 255.0 {
                continue;
            }
            if t * (1.0 - alpha) < 1e-4 {
                break;
            }
            for c in 0..3 {
                color[c] += alpha * t * f.color[c];
            }
            depth += alpha * t * f.depth;
            t *= 1.0 - alpha;
        }
        picture.color.push([0, 1, 2].map(|c| color[c] + t * background[c]));
        picture.transmittance.push(t);
        picture.depth.push(depth);
    }
    picture
}

/// (1 − λ) L1 + λ (1 − SSIM), by the definition: an 11×11 window around every pixel, zeros outside.
pub fn loss(color: &[[f64; 3]], image: &RgbBuffer, lambda: f64) -> f64 {
    let (w, h) = (image.width() as i64, image.height() as i64);
    let weight = |d: i64| (-(d * d) as f64 / (2.0 * 1.5 * 1.5)).exp();
    let total: f64 = (-5..=5).map(weight).sum();
    let (mut l1, mut ssim) = (0.0, 0.0);
    for c in 0..3 {
        let y = |i: i64, j: i64| f64::from(image.get(i as u32, j as u32)[c]) / 255.0;
        let x = |i: i64, j: i64| color[(j * w + i) as usize][c];
        for j in 0..h {
            for i in 0..w {
                l1 += (x(i, j) - y(i, j)).abs();
                let mut m = [0.0; 5];
                for (dj, di) in (-5..=5).flat_map(|dj| (-5..=5).map(move |di| (dj, di))) {
                    let (a, b) = (i + di, j + dj);
                    if (0..w).contains(&a) && (0..h).contains(&b) {
                        let g = weight(di) * weight(dj) / (total * total);
                        let (x, y) = (x(a, b), y(a, b));
                        for (m, v) in m.iter_mut().zip([x, y, x * x, y * y, x * y]) {
                            *m += g * v;
                        }
                    }
                }
                let [mx, my, xx, yy, xy] = m;
                ssim += (2.0 * mx * my + 1e-4) * (2.0 * (xy - mx * my) + 9e-4)
                    / ((mx * mx + my * my + 1e-4) * (xx - mx * mx + yy - my * my + 9e-4));
            }
        }
    }
    let n = (3 * w * h) as f64;
    (1.0 - lambda) * l1 / n + lambda * (1.0 - ssim / n)
}
