//! Vertices to pixel space, triangles to edge functions.
//!
//! With `P = K · x_camera` (pixel-homogeneous coordinates) a pixel's ray is `d = (u, v, 1)`, and
//! `d` hits the triangle in front of the camera exactly where the three edge functions
//! `E_i(u, v) = ± (P_j × P_k) · d` are all non-negative (Olano and Greer, "Triangle scan
//! conversion using 2D homogeneous coordinates", 1997). No clipping is needed: a triangle that
//! crosses the camera plane needs care in its bounding box only. `P_j × P_k` is exactly the
//! negative of `P_k × P_j` in floating point, so neighbours never leave a gap.
//!
//! `1 / z = Σ E_i / det`, linear in `(u, v)`.

use std::ops::Range;

use fuse_camera::Camera;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::geometry::Geometry;
use super::raster::{TILE_HEIGHT, TILE_WIDTH};

/// Fewest vertices that a task projects.
const FEWEST: usize = 2048;

/// A triangle that may cover pixels `x0..=x1`, `y0..=y1`.
#[derive(Clone, Copy)]
pub(super) struct Setup {
    /// `du u + dv v + value` are the edge functions `E_0`, `E_1`, `E_2`, barycentric weights up to
    /// their common sum, and `1 / z`.
    pub du: [f64; 4],
    pub dv: [f64; 4],
    pub value: [f64; 4],
    pub x0: u16,
    pub x1: u16,
    pub y0: u16,
    pub y1: u16,
    /// Index into [`Geometry::triangles`].
    pub triangle: u32,
    /// Index into [`Geometry::parts`].
    pub part: u32,
}

/// Where samples lie within pixels: decides which small triangles can be dropped.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Sampling {
    /// Anywhere in the pixel.
    Area,
    /// At the pixel centre only.
    Center,
}

/// A vertex in pixel-homogeneous coordinates, and its image coordinates (of use for `z > 0`).
#[derive(Clone, Copy)]
pub(super) struct Vertex {
    p: DVec3,
    u: f64,
    v: f64,
}

/// What maps the world to pixels.
pub(super) struct View {
    /// `K · R`.
    pub matrix: DMat3,
    /// `K · t`.
    pub offset: DVec3,
    pub width: u32,
    pub height: u32,
    pub near: f64,
}

impl View {
    pub fn new(camera: &Camera, near: f32) -> Self {
        let k = &camera.intrinsics;
        let r = camera.pose.rotation.to_rotation_matrix();
        let r = DMat3::from_cols_array_2d(&std::array::from_fn(|c| std::array::from_fn(|row| r[(row, c)])));
        let t = &camera.pose.translation;
        let k_matrix =
            DMat3::from_cols(DVec3::new(k.fx, 0.0, 0.0), DVec3::new(0.0, k.fy, 0.0), DVec3::new(k.cx, k.cy, 1.0));
        Self {
            matrix: k_matrix * r,
            offset: k_matrix * DVec3::new(t.x, t.y, t.z),
            width: k.width,
            height: k.height,
            near: f64::from(near),
        }
    }

    /// Every vertex of the scene, in order.
    pub fn vertices(&self, geometry: &Geometry, to: &mut Vec<Vertex>) {
        let project = |p: &glam::Vec3| {
            let p = self.matrix * p.as_dvec3() + self.offset;
            let inverse = 1.0 / p.z;
            Vertex { p, u: p.x * inverse, v: p.y * inverse }
        };
        geometry.positions.par_iter().with_min_len(FEWEST).map(project).collect_into_vec(to);
    }

    /// Those of the triangles that face the camera (or are double-sided) and may cover a sample, in order.
    pub fn setups(
        &self,
        geometry: &Geometry,
        vertices: &[Vertex],
        triangles: Range<usize>,
        sampling: Sampling,
        to: &mut Vec<Setup>,
    ) {
        let first = triangles.start;
        let parts = &geometry.triangle_part[triangles.clone()];
        for (i, (t, &part)) in geometry.triangles[triangles].iter().zip(parts).enumerate() {
            let q = [&vertices[t[0] as usize], &vertices[t[1] as usize], &vertices[t[2] as usize]];
            let double_sided = geometry.parts[part as usize].double_sided;
            to.extend(self.setup(q, ((first + i) as u32, part), double_sided, sampling));
        }
    }

    #[inline]
    fn setup(
        &self,
        q: [&Vertex; 3],
        (triangle, part): (u32, u32),
        double_sided: bool,
        sampling: Sampling,
    ) -> Option<Setup> {
        if !double_sided && self.turned_away(&q) {
            return None;
        }
        let (x0, x1, y0, y1) = self.pixel_bounds(&q, sampling)?;
        let p = [q[0].p, q[1].p, q[2].p];
        let n = [p[1].cross(p[2]), p[2].cross(p[0]), p[0].cross(p[1])];
        let det = p[0].dot(n[0]);
        // Counter-clockwise seen from outside faces the camera when det < 0 (y is down).
        if det == 0.0 || !det.is_finite() || (det > 0.0 && !double_sided) {
            return None;
        }
        let edges = if det < 0.0 { [-n[0], -n[1], -n[2]] } else { n };
        let inverse_depth = (edges[0] + edges[1] + edges[2]) / det.abs();
        let [a, b, c] = edges;
        let d = inverse_depth;
        let (du, dv, value) = ([a.x, b.x, c.x, d.x], [a.y, b.y, c.y, d.y], [a.z, b.z, c.z, d.z]);
        Some(Setup { du, dv, value, x0, x1, y0, y1, triangle, part })
    }

    /// Whether a triangle in front of the camera is seen from behind, without doubt.
    #[inline]
    fn turned_away(&self, [a, b, c]: &[&Vertex; 3]) -> bool {
        let (abx, aby, acx, acy) = (b.u - a.u, b.v - a.v, c.u - a.u, c.v - a.v);
        // Positive areas are clockwise in the picture, where v grows downwards.
        let area = abx * acy - aby * acx;
        area > 1e-6 && a.p.z.min(b.p.z).min(c.p.z) >= self.near
    }

    /// Inclusive pixel bounds; `None` when no sample of the image can be covered.
    #[inline]
    fn pixel_bounds(&self, q: &[&Vertex; 3], sampling: Sampling) -> Option<(u16, u16, u16, u16)> {
        let [a, b, c] = q;
        let (lo, hi) = if a.p.z.min(b.p.z).min(c.p.z) >= self.near {
            let lo = (a.u.min(b.u).min(c.u), a.v.min(b.v).min(c.v));
            (lo, (a.u.max(b.u).max(c.u), a.v.max(b.v).max(c.v)))
        } else {
            self.clipped_bounds(q)
        };
        let (x0, x1) = pixel_range(lo.0, hi.0, self.width, sampling)?;
        let (y0, y1) = pixel_range(lo.1, hi.1, self.height, sampling)?;
        Some((x0, x1, y0, y1))
    }

    /// Image bounds `(low, high)` of the part beyond the near plane.
    fn clipped_bounds(&self, q: &[&Vertex; 3]) -> ((f64, f64), (f64, f64)) {
        let (mut lo, mut hi) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        let mut extend = |p: DVec3| {
            let (u, v) = (p.x / p.z, p.y / p.z);
            lo = (lo.0.min(u), lo.1.min(v));
            hi = (hi.0.max(u), hi.1.max(v));
        };
        for i in 0..3 {
            let (a, b) = (q[i].p, q[(i + 1) % 3].p);
            if a.z >= self.near {
                extend(a);
            }
            if (a.z >= self.near) != (b.z >= self.near) {
                extend(a + (b - a) * ((self.near - a.z) / (b.z - a.z)));
            }
        }
        (lo, hi)
    }
}

/// First and last pixel along one axis with a sample in `[lo, hi]`, inside the image.
#[inline]
fn pixel_range(lo: f64, hi: f64, size: u32, sampling: Sampling) -> Option<(u16, u16)> {
    // A thousandth of a pixel covers the rounding of the projection.
    let (lo, hi) = (lo - 1e-3, hi + 1e-3);
    let last = f64::from(size) - 1.0;
    let (first, end) = match sampling {
        Sampling::Area => (lo, hi),
        Sampling::Center => (lo - 0.5, hi - 0.5),
    };
    if !(end >= 0.0 && first <= last + 1.0) {
        return None;
    }
    // Rounding by conversion: the numbers are in range, and floor() is a library call.
    let (first, end) = (first.max(0.0), end.min(last));
    let mut pixel = first as u16;
    if sampling == Sampling::Center && f64::from(pixel) < first {
        pixel += 1;
    }
    let end = end as u16;
    (pixel <= end).then_some((pixel, end))
}

impl Setup {
    /// Planar depth at continuous image coordinates, metres.
    #[inline(always)]
    pub fn depth(&self, u: f64, v: f64) -> f32 {
        (1.0 / self.inverse_depth(u, v)) as f32
    }

    /// The same inverted.
    #[inline(always)]
    pub fn inverse_depth(&self, u: f64, v: f64) -> f64 {
        self.du[3] * u + self.dv[3] * v + self.value[3]
    }

    /// Edge functions and inverse depth at continuous image coordinates.
    #[inline(always)]
    pub fn at(&self, u: f64, v: f64) -> [f64; 4] {
        std::array::from_fn(|i| self.du[i] * u + self.dv[i] * v + self.value[i])
    }

    /// Columns and rows of the tiles that it may touch.
    #[inline]
    pub fn tiles(&self) -> (Range<usize>, Range<usize>) {
        let columns = self.x0 as usize / TILE_WIDTH..self.x1 as usize / TILE_WIDTH + 1;
        (columns, self.y0 as usize / TILE_HEIGHT..self.y1 as usize / TILE_HEIGHT + 1)
    }
}
