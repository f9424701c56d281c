//! Metal-rough shading of one surface point.

use glam::{DVec3, Vec2, Vec3A};

use super::geometry::{Geometry, Surface};
use super::occlusion::Occlusion;
use super::shadow::Shadow;
use super::transform::Setup;
use crate::Light;

/// The tone curve is straight up to here, and how fast colours beyond it turn white.
pub(crate) const TONE_START: f32 = 0.76;
pub(crate) const TONE_DESATURATION: f32 = 0.15;

/// What shading reads; made once for a scene.
pub(crate) struct Shading {
    pub light: Lamp,
    pub shadow: Option<Shadow>,
    pub occlusion: Option<Occlusion>,
    pub encode: SrgbTable,
}

/// The light, ready for use.
pub(crate) struct Lamp {
    pub position: Vec3A,
    pub radius: f32,
    pub intensity: Vec3A,
    pub sky: Vec3A,
    pub ground: Vec3A,
    pub soft_boxes: Vec<Patch>,
    pub exposure: f32,
}

/// A soft box; see [`crate::SoftBox`].
pub(crate) struct Patch {
    pub direction: Vec3A,
    pub color: Vec3A,
    pub sharpness: f32,
}

impl Lamp {
    fn new(light: &Light) -> Self {
        let patch = |b: &crate::SoftBox| Patch {
            direction: Vec3A::from(b.direction).normalize_or(Vec3A::Z),
            color: b.color.into(),
            sharpness: b.sharpness,
        };
        Self {
            position: light.position.into(),
            radius: light.radius,
            intensity: light.intensity.into(),
            sky: light.sky.into(),
            ground: light.ground.into(),
            soft_boxes: light.soft_boxes.iter().map(patch).collect(),
            exposure: light.exposure,
        }
    }
}

/// Ready to interpolate over one triangle: attributes times `1 / z` are linear over the image.
pub(super) struct Shader<'a> {
    geometry: &'a Geometry,
    shading: &'a Shading,
    eye: Vec3A,
    /// Key of the triangle that the planes belong to; 0 for none.
    key: u32,
    /// Image coordinates at which `value` holds.
    origin: (f64, f64),
    planes: Planes,
    surface: usize,
}

/// Value, and change along image x and y, of the weights' sum and of each attribute times it.
#[derive(Default)]
struct Planes {
    sum: [f32; 3],
    position: [Vec3A; 3],
    normal: [Vec3A; 3],
    uv: [Vec2; 3],
    facet: Vec3A,
}

/// A surface point seen through a pixel.
struct Point<'a> {
    position: Vec3A,
    /// Unit, towards the viewer's side.
    normal: Vec3A,
    /// Of the triangle, towards the viewer's side.
    facet: Vec3A,
    /// Unit, towards the eye.
    view: Vec3A,
    uv: Vec2,
    du: Vec2,
    dv: Vec2,
    surface: &'a Surface,
}

impl Planes {
    fn new(geometry: &Geometry, setup: &Setup, (u, v): (f64, f64)) -> Self {
        let t = geometry.triangles[setup.triangle as usize].map(|v| v as usize);
        let at = DVec3::new(u, v, 1.0);
        // The common factor keeps single precision in range.
        let total = setup.edges[0] + setup.edges[1] + setup.edges[2];
        let scale = 1.0 / total.dot(at);
        let mut planes = Self::default();
        for (i, &v) in t.iter().enumerate() {
            let e = setup.edges[i];
            let weights = [e.dot(at) * scale, e.x * scale, e.y * scale].map(|w| w as f32);
            let (p, n) = (Vec3A::from(geometry.positions[v]), Vec3A::from(geometry.normals[v]));
            let uv = geometry.uvs[v];
            for (k, w) in weights.into_iter().enumerate() {
                planes.position[k] += p * w;
                planes.normal[k] += n * w;
                planes.uv[k] += uv * w;
            }
        }
        planes.sum = [1.0, (total.x * scale) as f32, (total.y * scale) as f32];
        let p = t.map(|v| Vec3A::from(geometry.positions[v]));
        planes.facet = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or(Vec3A::Z);
        planes
    }
}

impl<'a> Shader<'a> {
    pub fn new(geometry: &'a Geometry, shading: &'a Shading, eye: Vec3A) -> Self {
        Self { geometry, shading, eye, key: 0, origin: (0.0, 0.0), planes: Planes::default(), surface: 0 }
    }

    /// Forgets the triangle; to be called for each tile, so that results do not depend on which
    /// tile was shaded before.
    pub fn reset(&mut self) {
        self.key = 0;
    }

    /// Display-linear colour of a triangle at pixel `(x, y)` plus `(dx, dy)`; `key` tells
    /// triangles of one view apart and is never 0.
    pub fn color(&mut self, setup: &Setup, key: u32, (x, y): (usize, usize), dx: f32, dy: f32) -> Vec3A {
        if key != self.key {
            self.origin = (x as f64 + 0.5 + f64::from(dx), y as f64 + 0.5 + f64::from(dy));
            self.planes = Planes::new(self.geometry, setup, self.origin);
            let part = self.geometry.triangle_part[setup.triangle as usize];
            self.surface = self.geometry.parts[part as usize].surface as usize;
            self.key = key;
        }
        let du = (x as f64 + 0.5 - self.origin.0) as f32 + dx;
        let dv = (y as f64 + 0.5 - self.origin.1) as f32 + dy;
        let p = self.point(du, dv);
        let mut base = p.surface.base;
        if let Some(texture) = &p.surface.texture {
            base *= texture.sample(p.uv, p.du, p.dv);
        }
        self.shading.display(self.shading.reflected(&p, base))
    }

    #[inline]
    fn point(&self, du: f32, dv: f32) -> Point<'a> {
        let l = &self.planes;
        let inverse = 1.0 / (l.sum[0] + l.sum[1] * du + l.sum[2] * dv);
        let position = (l.position[0] + l.position[1] * du + l.position[2] * dv) * inverse;
        let normal = l.normal[0] + l.normal[1] * du + l.normal[2] * dv;
        let uv = (l.uv[0] + l.uv[1] * du + l.uv[2] * dv) * inverse;
        let to_eye = self.eye - position;
        // Back faces of double-sided surfaces are lit like front faces.
        let side = if l.facet.dot(to_eye) < 0.0 { -1.0 } else { 1.0 };
        let facet = l.facet * side;
        Point {
            position,
            normal: normal.normalize_or(l.facet) * side,
            facet,
            view: to_eye.normalize_or(facet),
            uv,
            du: (l.uv[1] - uv * l.sum[1]) * inverse,
            dv: (l.uv[2] - uv * l.sum[2]) * inverse,
            surface: &self.geometry.surfaces[self.surface],
        }
    }
}

impl Shading {
    pub fn new(light: &Light, shadow: Option<Shadow>, occlusion: Option<Occlusion>) -> Self {
        Self { light: Lamp::new(light), shadow, occlusion, encode: SrgbTable::new() }
    }

    /// Radiance towards the viewer.
    fn reflected(&self, p: &Point<'_>, base: Vec3A) -> Vec3A {
        let (metallic, roughness) = (p.surface.metallic, p.surface.roughness);
        let f0 = Vec3A::splat(0.04).lerp(base, metallic);
        let diffuse = base * (1.0 - metallic);
        let nv = p.normal.dot(p.view).max(1e-3);
        let reflection = p.normal * (2.0 * p.normal.dot(p.view)) - p.view;
        let blocked = self.occlusion.as_ref().map(|o| o.at(p.position, p.normal, reflection));
        let (hidden, hidden_mirror) = blocked.unwrap_or_default();
        let ambient = diffuse * self.irradiance(p.normal) * (1.0 - hidden)
            + environment_brdf(f0, roughness, nv) * self.surroundings(reflection, roughness) * (1.0 - hidden_mirror);
        ambient + self.key(p, diffuse, f0, nv, roughness)
    }

    /// Light from the key lamp: Lambert and GGX, the lamp's size widening the highlight.
    fn key(&self, p: &Point<'_>, diffuse: Vec3A, f0: Vec3A, nv: f32, roughness: f32) -> Vec3A {
        let to_light = self.light.position - p.position;
        let distance2 = to_light.length_squared().max(1e-4);
        let l = to_light / distance2.sqrt();
        let nl = p.normal.dot(l);
        if nl <= 0.0 || p.facet.dot(l) <= 0.0 {
            return Vec3A::ZERO;
        }
        let visible = self.shadow.as_ref().map_or(1.0, |s| s.visibility(p.position, p.facet));
        if visible <= 0.0 {
            return Vec3A::ZERO;
        }
        let h = (l + p.view).normalize_or(p.normal);
        let (nh, vh) = (p.normal.dot(h).clamp(0.0, 1.0), p.view.dot(h).clamp(0.0, 1.0));
        let alpha = roughness * roughness;
        let wide = (alpha + 0.5 * self.light.radius / distance2.sqrt()).min(1.0);
        let a2 = wide * wide;
        let d = nh * nh * (a2 - 1.0) + 1.0;
        // GGX times π, since `intensity` is over π.
        let distribution = a2 / (d * d).max(1e-8);
        let k = alpha * 0.5;
        let visibility = 0.25 / ((nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
        let f = (1.0 - vh) * (1.0 - vh);
        let fresnel = f0 + (Vec3A::ONE - f0) * (f * f * (1.0 - vh));
        (diffuse + fresnel * (distribution * visibility)) * self.light.intensity * (visible * nl / distance2)
    }

    /// Ambient irradiance over π on a surface with this normal.
    fn irradiance(&self, n: Vec3A) -> Vec3A {
        let mut sum = self.light.ground.lerp(self.light.sky, 0.5 + 0.5 * n.z);
        for b in &self.light.soft_boxes {
            // The patch's solid angle is 2π/s (1 - 1/(1 + 2s)) ≈ 2π/s; the cosine is wrapped.
            let c = (0.5 + 0.5 * n.dot(b.direction)).max(0.0);
            sum += b.color * (2.0 / (1.0 + b.sharpness) * c * c);
        }
        sum
    }

    /// Ambient radiance from a direction, blurred as a surface of this roughness sees it.
    fn surroundings(&self, d: Vec3A, roughness: f32) -> Vec3A {
        let t = (0.5 + d.z / (0.3 + 1.7 * roughness)).clamp(0.0, 1.0);
        let mut sum = self.light.ground.lerp(self.light.sky, t * t * (3.0 - 2.0 * t));
        // Walls are brighter than floor and ceiling, which see the lamp at a steeper angle.
        let level = 1.0 - d.z * d.z;
        sum += self.light.sky * (0.7 * level * level);
        let a = roughness * roughness;
        for b in &self.light.soft_boxes {
            let s = b.sharpness / (1.0 + b.sharpness * a);
            let lobe = 1.0 / (1.0 + s * (1.0 - d.dot(b.direction)));
            sum += b.color * (lobe * lobe * (1.0 + s) / (1.0 + b.sharpness));
        }
        sum
    }

    /// Exposure and tone curve: neutral below 0.76, smooth shoulder above (Khronos PBR neutral,
    /// without its toe), in [0, 1].
    pub fn display(&self, radiance: Vec3A) -> Vec3A {
        let c = radiance * self.light.exposure;
        let peak = c.max_element();
        if peak < TONE_START {
            return c.max(Vec3A::ZERO);
        }
        let d = 1.0 - TONE_START;
        let new_peak = 1.0 - d * d / (peak + d - TONE_START);
        let g = 1.0 - 1.0 / (TONE_DESATURATION * (peak - new_peak) + 1.0);
        (c * (new_peak / peak)).lerp(Vec3A::splat(new_peak), g).clamp(Vec3A::ZERO, Vec3A::ONE)
    }
}

/// Split-sum environment reflectance, analytic fit (Karis, "Physically based shading on
/// mobile", 2014).
fn environment_brdf(f0: Vec3A, roughness: f32, nv: f32) -> Vec3A {
    let r = [-roughness + 1.0, -0.0275 * roughness + 0.0425, -0.572 * roughness + 1.04, 0.022 * roughness - 0.04];
    let (a, edge) = (r[0] * r[0], 1.0 - nv);
    // The fit's 2^(-9.28 nv) is replaced by (1 - nv)⁵: no library call, the same bits anywhere.
    let edge = edge * edge * edge * edge * edge;
    let a004 = a.min(edge) * r[0] + r[1];
    let (scale, bias) = (-1.04 * a004 + r[2], 1.04 * a004 + r[3]);
    f0 * scale + Vec3A::splat(bias)
}

/// Linear [0, 1] to sRGB bytes.
pub(crate) struct SrgbTable(Vec<u8>);

impl SrgbTable {
    pub(crate) const SIZE: usize = 1 << 14;

    pub fn new() -> Self {
        let byte = |i: usize| {
            let v = i as f64 / (Self::SIZE - 1) as f64;
            let s = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
            (s * 255.0 + 0.5) as u8
        };
        Self((0..Self::SIZE).map(byte).collect())
    }

    pub fn encode(&self, c: Vec3A) -> [u8; 3] {
        let c = c * (Self::SIZE - 1) as f32 + Vec3A::splat(0.5);
        c.to_array().map(|v| self.0[(v as usize).min(Self::SIZE - 1)])
    }
}
