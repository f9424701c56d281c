//! Camera models: COLMAP's parameters as a pinhole and a distortion, and the pinhole that an image
//! has once the distortion is taken out.
//!
//! With (x, y) on the plane z = 1 and r² = x² + y²:
//! x' = x R + 2 p₁ x y + p₂ (r² + 2x²), y' = y R + 2 p₂ x y + p₁ (r² + 2y²),
//! R = (1 + k₁r² + k₂r⁴ + k₃r⁶) / (1 + k₄r² + k₅r⁴ + k₆r⁶), as in COLMAP and OpenCV.

use fuse_camera::Pinhole;

/// How far the image may be enlarged or reduced to leave out what the photo does not show.
const ZOOM: [f64; 2] = [0.5, 4.0];
/// Each side is checked at so many places to lie within the photo.
const BORDER: u32 = 128;
/// The distortion is checked to be one-to-one at so many places along each side.
const CHECKS: u32 = 24;

/// A lens's distortion; all zero for none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lens {
    /// Radial coefficients k₁ … k₆.
    pub k: [f64; 6],
    /// Tangential coefficients p₁, p₂.
    pub p: [f64; 2],
}

/// COLMAP's camera models: number in binary files, name, number of parameters. Only the first
/// seven are perspective with the distortion above.
const MODELS: [(i32, &str, usize); 12] = [
    (0, "SIMPLE_PINHOLE", 3),
    (1, "PINHOLE", 4),
    (2, "SIMPLE_RADIAL", 4),
    (3, "RADIAL", 5),
    (4, "OPENCV", 8),
    (6, "FULL_OPENCV", 12),
    (5, "OPENCV_FISHEYE", 8),
    (7, "FOV", 5),
    (8, "SIMPLE_RADIAL_FISHEYE", 4),
    (9, "RADIAL_FISHEYE", 5),
    (10, "THIN_PRISM_FISHEYE", 12),
    (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16),
];

const ADVICE: &str =
    "pinhole, radial and OpenCV models are read; make undistorted images with `colmap image_undistorter` first";

/// Name and number of parameters of a model in a binary file.
pub(crate) fn model_by_number(number: i32) -> Result<(&'static str, usize), String> {
    MODELS
        .iter()
        .find(|m| m.0 == number)
        .map(|m| (m.1, m.2))
        .ok_or_else(|| format!("camera model number {number} unknown; {ADVICE}"))
}

/// Pinhole and lens of a COLMAP camera.
///
/// # Errors
/// If the model is unknown or not perspective, the number of parameters is wrong, or a value is out
/// of range.
pub(crate) fn camera(model: &str, width: u64, height: u64, params: &[f64]) -> Result<(Pinhole, Lens), String> {
    let known = MODELS.iter().find(|m| m.1 == model);
    let (.., count) = known.ok_or_else(|| format!("camera model `{model}` unknown; {ADVICE}"))?;
    if params.len() != *count {
        return Err(format!("camera model {model} has {count} parameters, found {}", params.len()));
    }
    let mut lens = Lens::default();
    let [fx, fy, cx, cy] = match (model, params) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => [f, f, cx, cy],
        ("PINHOLE", &[fx, fy, cx, cy]) => [fx, fy, cx, cy],
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => {
            lens.k[0] = k;
            [f, f, cx, cy]
        }
        ("RADIAL", &[f, cx, cy, k1, k2]) => {
            lens.k[..2].copy_from_slice(&[k1, k2]);
            [f, f, cx, cy]
        }
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            lens = Lens { k: [k1, k2, 0.0, 0.0, 0.0, 0.0], p: [p1, p2] };
            [fx, fy, cx, cy]
        }
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            lens = Lens { k: [k1, k2, k3, k4, k5, k6], p: [p1, p2] };
            [fx, fy, cx, cy]
        }
        _ => return Err(format!("camera model {model} is not supported; {ADVICE}")),
    };
    lens.check()?;
    let side = |v: u64| u32::try_from(v).unwrap_or(u32::MAX);
    let pinhole = Pinhole::new(side(width), side(height), fx, fy, cx, cy).map_err(|e| e.to_string())?;
    Ok((pinhole, lens))
}

impl Lens {
    /// Refuses coefficients that are not finite.
    pub(crate) fn check(&self) -> Result<(), String> {
        match self.k.iter().chain(&self.p).find(|v| !v.is_finite()) {
            Some(v) => Err(format!("a distortion coefficient is {v}, expected a finite number")),
            None => Ok(()),
        }
    }

    /// Whether there is no distortion.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Where a point of the plane z = 1 appears.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let ([k1, k2, k3, k4, k5, k6], [p1, p2]) = (self.k, self.p);
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y),
        )
    }

    /// Whether the distortion keeps orientation at a point (determinant of its Jacobian, by central
    /// differences): where it does not, it folds the plane over and has no inverse.
    fn unfolded(&self, x: f64, y: f64) -> bool {
        const H: f64 = 1e-5;
        let ((ax, ay), (bx, by)) = (self.distort(x + H, y), self.distort(x - H, y));
        let ((cx, cy), (dx, dy)) = (self.distort(x, y + H), self.distort(x, y - H));
        (ax - bx) * (cy - dy) - (ay - by) * (cx - dx) > 0.0
    }

    /// Where a pixel of the undistorted image (continuous coordinates) lies in the photo.
    pub(crate) fn source(&self, pinhole: &Pinhole, undistorted: &Pinhole, u: f64, v: f64) -> (f64, f64) {
        let (x, y) = self.distort((u - undistorted.cx) / undistorted.fx, (v - undistorted.cy) / undistorted.fy);
        (pinhole.fx * x + pinhole.cx, pinhole.fy * y + pinhole.cy)
    }

    /// The pinhole of the undistorted image: size and principal point of the photo, and the shortest
    /// focal lengths (in one ratio) at which every pixel lies within the photo.
    ///
    /// # Errors
    /// If no zoom between a half and four does, or the distortion folds over within the image.
    pub fn undistorted(&self, pinhole: &Pinhole) -> Result<Pinhole, String> {
        if self.is_none() {
            return Ok(*pinhole);
        }
        let zoomed = |zoom: f64| Pinhole { fx: pinhole.fx * zoom, fy: pinhole.fy * zoom, ..*pinhole };
        let [mut low, mut high] = ZOOM;
        if !self.covers(pinhole, &zoomed(high)) {
            return Err(format!("the distortion {self:?} is too strong to be taken out; {ADVICE}"));
        }
        if self.covers(pinhole, &zoomed(low)) {
            return Ok(zoomed(low));
        }
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if self.covers(pinhole, &zoomed(middle)) { high = middle } else { low = middle }
        }
        Ok(zoomed(high))
    }

    /// Whether the undistorted image's border, hence every pixel, lies within the photo, between the centres of
    /// its outermost pixels, and the distortion has an inverse there.
    fn covers(&self, pinhole: &Pinhole, undistorted: &Pinhole) -> bool {
        let (w, h) = (f64::from(pinhole.width), f64::from(pinhole.height));
        let inside = |u: f64, v: f64| {
            let (su, sv) = self.source(pinhole, undistorted, u, v);
            // Pixels outermost in the photo have their centre half a pixel inside.
            (0.5..=w - 0.5).contains(&su) && (0.5..=h - 0.5).contains(&sv)
        };
        // Along a side the distortion is smooth: its extremes lie between so many places to far less
        // than a pixel.
        let edge = |side: f64| (0..=BORDER).map(move |i| 0.5 + (side - 1.0) * f64::from(i) / f64::from(BORDER));
        let border = edge(w).all(|u| inside(u, 0.5) && inside(u, h - 0.5))
            && edge(h).all(|v| inside(0.5, v) && inside(w - 0.5, v));
        border
            && (0..=CHECKS).all(|i| {
                (0..=CHECKS).all(|j| {
                    let u = w * f64::from(i) / f64::from(CHECKS);
                    let v = h * f64::from(j) / f64::from(CHECKS);
                    self.unfolded((u - undistorted.cx) / undistorted.fx, (v - undistorted.cy) / undistorted.fy)
                })
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_reach_their_places() {
        let (p, l) = camera("OPENCV", 640, 480, &[500.0, 510.0, 320.0, 240.0, 0.1, 0.2, 0.3, 0.4]).unwrap();
        assert_eq!((p.fx, p.fy, p.cx, p.cy), (500.0, 510.0, 320.0, 240.0));
        assert_eq!(l, Lens { k: [0.1, 0.2, 0.0, 0.0, 0.0, 0.0], p: [0.3, 0.4] });
        let (p, l) = camera("SIMPLE_PINHOLE", 640, 480, &[500.0, 320.0, 240.0]).unwrap();
        assert!(p.fx == 500.0 && p.fy == 500.0 && l.is_none());
    }

    #[test]
    fn other_models_are_refused_with_advice() {
        for (model, params, part) in [
            ("OPENCV_FISHEYE", 8, "OPENCV_FISHEYE is not supported"),
            ("FOV", 5, "`colmap image_undistorter`"),
            ("CUBIST", 4, "camera model `CUBIST` unknown"),
            ("PINHOLE", 3, "PINHOLE has 4 parameters, found 3"),
        ] {
            let message = camera(model, 640, 480, &vec![500.0; params]).unwrap_err();
            assert!(message.contains(part), "{message}");
        }
        assert!(model_by_number(99).unwrap_err().contains("number 99 unknown"));
        let message = camera("SIMPLE_RADIAL", 640, 480, &[500.0, 320.0, 240.0, f64::NAN]).unwrap_err();
        assert!(message.contains("coefficient is NaN"), "{message}");
        assert!(camera("PINHOLE", u64::MAX, 480, &[1.0; 4]).unwrap_err().contains("image size"));
    }

    #[test]
    fn the_undistorted_image_is_full_and_no_smaller_than_it_must_be() {
        let pinhole = Pinhole::new(640, 480, 500.0, 505.0, 315.0, 243.0).unwrap();
        for k1 in [-0.25, -0.05, 0.1, 0.3] {
            let lens = Lens { k: [k1, 0.02, 0.0, 0.0, 0.0, 0.0], p: [1e-3, -2e-3] };
            let new = lens.undistorted(&pinhole).unwrap();
            assert!(lens.covers(&pinhole, &new));
            assert!(!lens.covers(&pinhole, &Pinhole { fx: 0.999 * new.fx, fy: 0.999 * new.fy, ..new }));
        }
        let wild = Lens { k: [-40.0, 0.0, 0.0, 0.0, 0.0, 0.0], p: [0.0; 2] };
        assert!(wild.undistorted(&pinhole).unwrap_err().contains("too strong"));
    }
}
