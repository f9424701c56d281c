//! Surface points seen through pixels, eight at a time: perspective-correct interpolation.

use fuse_camera::simd::F32x8;
use glam::Vec3A;

use super::binned::Binned;
use super::geometry::Geometry;
use super::lanes::{V3, less};
use super::transform::Setup;

/// Points of one group.
pub(super) const GROUP: usize = 8;

/// The triangles of a view.
pub(super) struct Triangles<'a> {
    pub geometry: &'a Geometry,
    pub binned: &'a Binned,
}

/// A triangle at a place of a pixel.
#[derive(Clone, Copy, Default)]
pub(super) struct Fragment {
    /// Number of the setup.
    pub setup: u32,
    /// Pixel of the image.
    pub x: u16,
    pub y: u16,
    /// Offset from the pixel's centre, pixels.
    pub dx: f32,
    pub dy: f32,
}

impl Fragment {
    /// Image coordinates.
    #[inline(always)]
    pub fn at(&self) -> (f64, f64) {
        (f64::from(self.x) + 0.5 + f64::from(self.dx), f64::from(self.y) + 0.5 + f64::from(self.dy))
    }
}

/// Eight surface points, a list for each component.
#[derive(Clone, Default)]
pub(super) struct Points {
    pub position: [[f32; GROUP]; 3],
    /// Interpolated; of unit length and towards the viewer's side after [`Points::face`].
    pub normal: [[f32; GROUP]; 3],
    /// Unit normal of the triangle; towards the viewer's side after [`Points::face`].
    pub facet: [[f32; GROUP]; 3],
    /// Unit direction towards the eye, set by [`Points::face`].
    pub view: [[f32; GROUP]; 3],
    pub uv: [[f32; GROUP]; 2],
    /// Change of the texture coordinates from one pixel to the next along x.
    pub du: [[f32; GROUP]; 2],
    /// The same along y.
    pub dv: [[f32; GROUP]; 2],
    /// Index of their surface.
    pub surface: usize,
}

impl Points {
    /// Interpolates the triangles at the fragments, which are of one surface.
    #[inline(always)]
    pub fn fill<V: F32x8>(&mut self, scene: &Triangles<'_>, fragments: &[Fragment; GROUP]) {
        let Triangles { geometry, binned } = scene;
        let first = &fragments[0];
        self.surface = geometry.parts[binned.setup(first.setup).part as usize].surface as usize;
        let mut other = 0;
        for fragment in fragments {
            other |= fragment.setup ^ first.setup;
        }
        if other == 0 {
            self.interpolate_one::<V>(geometry, binned.setup(first.setup), fragments);
        } else {
            self.interpolate::<V>(scene, fragments);
        }
    }

    /// Turns normals towards the viewer's side: back faces of double-sided surfaces are lit like
    /// front faces.
    #[inline(always)]
    pub fn face<V: F32x8>(&mut self, eye: Vec3A) {
        let facet = V3::<V>::load(&self.facet);
        let to_eye = V3::splat(eye) - V3::load(&self.position);
        let normal = V3::load(&self.normal).normalize_or(facet);
        let side = V::splat(-1.0).select(less(facet.dot(to_eye), V::zero()), V::splat(1.0));
        let facet = facet.scale(side);
        normal.scale(side).store(&mut self.normal);
        facet.store(&mut self.facet);
        to_eye.normalize_or(facet).store(&mut self.view);
    }

    /// One triangle at all fragments.
    #[inline(always)]
    fn interpolate_one<V: F32x8>(&mut self, geometry: &Geometry, setup: &Setup, fragments: &[Fragment; GROUP]) {
        let triangle = setup.triangle as usize;
        let (u, v) = fragments[0].at();
        let at = setup.at(u, v);
        let (mut x, mut y) = ([0.0; GROUP], [0.0; GROUP]);
        for (i, f) in fragments.iter().enumerate() {
            x[i] = f32::from(f.x) - f32::from(fragments[0].x) + (f.dx - fragments[0].dx);
            y[i] = f32::from(f.y) - f32::from(fragments[0].y) + (f.dy - fragments[0].dy);
        }
        let (x, y) = (V::load(&x), V::load(&y));
        // The common factor keeps single precision in range.
        let scale = 1.0 / (at[0] + at[1] + at[2]);
        let (mut e, mut total) = ([V::zero(); 3], V::zero());
        let (mut ex, mut ey) = ([0.0f32; 3], [0.0f32; 3]);
        for k in 0..3 {
            (ex[k], ey[k]) = ((setup.du[k] * scale) as f32, (setup.dv[k] * scale) as f32);
            e[k] = V::splat((at[k] * scale) as f32) + V::splat(ex[k]) * x + V::splat(ey[k]) * y;
            total = total + e[k];
        }
        let (sx, sy) = (V::splat(ex[0] + ex[1] + ex[2]), V::splat(ey[0] + ey[1] + ey[2]));
        let inverse = V::splat(1.0) / total;
        let mut position = V3::all(V::zero());
        let mut normal = position;
        let (mut uv, mut du, mut dv) = ([V::zero(); 2], [V::zero(); 2], [V::zero(); 2]);
        for k in 0..3 {
            let vertex = &geometry.vertices[geometry.triangles[triangle][k] as usize];
            let b = e[k] * inverse;
            position = position + V3::splat(vertex.position.into()).scale(b);
            normal = normal + V3::splat(vertex.normal.into()).scale(b);
            let (bx, by) = ((V::splat(ex[k]) - b * sx) * inverse, (V::splat(ey[k]) - b * sy) * inverse);
            for c in 0..2 {
                let at = V::splat(vertex.uv[c]);
                uv[c] = uv[c] + at * b;
                du[c] = du[c] + at * bx;
                dv[c] = dv[c] + at * by;
            }
        }
        position.store(&mut self.position);
        normal.store(&mut self.normal);
        V3::<V>::splat(geometry.facets[triangle]).store(&mut self.facet);
        for c in 0..2 {
            uv[c].store(&mut self.uv[c]);
            du[c].store(&mut self.du[c]);
            dv[c].store(&mut self.dv[c]);
        }
    }

    /// A triangle for each fragment.
    #[inline(always)]
    fn interpolate<V: F32x8>(&mut self, scene: &Triangles<'_>, fragments: &[Fragment; GROUP]) {
        let Triangles { geometry, binned } = scene;
        // Barycentric coordinates, and the edges' change along x and y.
        let (mut b, mut ex, mut ey) = ([[0.0f32; GROUP]; 3], [[0.0f32; GROUP]; 3], [[0.0f32; GROUP]; 3]);
        let mut corners = [[0u32; 3]; GROUP];
        for (lane, fragment) in fragments.iter().enumerate() {
            let setup = binned.setup(fragment.setup);
            let (u, v) = fragment.at();
            let e = setup.at(u, v);
            let scale = 1.0 / (e[0] + e[1] + e[2]);
            for k in 0..3 {
                b[k][lane] = (e[k] * scale) as f32;
                ex[k][lane] = (setup.du[k] * scale) as f32;
                ey[k][lane] = (setup.dv[k] * scale) as f32;
            }
            let triangle = setup.triangle as usize;
            corners[lane] = geometry.triangles[triangle];
            for (c, facet) in geometry.facets[triangle].to_array().into_iter().enumerate() {
                self.facet[c][lane] = facet;
            }
        }
        let (b, ex, ey) = (V3::load(&b), V3::load(&ex), V3::load(&ey));
        let (b, ex, ey): ([V; 3], [V; 3], [V; 3]) = ([b.x, b.y, b.z], [ex.x, ex.y, ex.z], [ey.x, ey.y, ey.z]);
        let (sx, sy) = (ex[0] + ex[1] + ex[2], ey[0] + ey[1] + ey[2]);
        let mut sum = [V::zero(); 8];
        let (mut du, mut dv) = ([V::zero(); 2], [V::zero(); 2]);
        for k in 0..3 {
            let mut rows = [V::zero(); GROUP];
            for (row, corners) in rows.iter_mut().zip(&corners) {
                *row = V::load(&geometry.vertices[corners[k] as usize].row());
            }
            let columns = V::transpose(rows);
            for (sum, column) in sum.iter_mut().zip(columns) {
                *sum = *sum + column * b[k];
            }
            let (bx, by) = (ex[k] - b[k] * sx, ey[k] - b[k] * sy);
            for c in 0..2 {
                du[c] = du[c] + columns[6 + c] * bx;
                dv[c] = dv[c] + columns[6 + c] * by;
            }
        }
        for c in 0..3 {
            sum[c].store(&mut self.position[c]);
            sum[3 + c].store(&mut self.normal[c]);
        }
        for c in 0..2 {
            sum[6 + c].store(&mut self.uv[c]);
            du[c].store(&mut self.du[c]);
            dv[c].store(&mut self.dv[c]);
        }
    }
}
