//! Metal-rough shading of surface points, eight at a time.

use fuse_camera::simd::{F32x8, Kernel, Level, dispatch};
use glam::Vec3A;

use super::geometry::Surface;
use super::lanes::{V3, clamp};
use super::occlusion::Occlusion;
use super::points::{Fragment, GROUP, Points, Triangles};
use super::shadow::Shadow;
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

/// Groups that are shaded together.
const BATCH: usize = 16;

/// Shades fragments: `colors` are display-linear, as many as `fragments`, which come in whole groups.
///
/// One step after the other for a batch of groups: the groups of a step do not wait for one another, so
/// that the processor works on several at a time; and a batch stays in its nearest cache.
pub(super) struct Shade<'a> {
    pub scene: &'a Triangles<'a>,
    pub shading: &'a Shading,
    pub eye: Vec3A,
    pub fragments: &'a [Fragment],
    pub colors: &'a mut [Vec3A],
    pub groups: &'a mut Vec<Group>,
}

/// What is known of eight points.
#[derive(Clone, Default)]
pub(super) struct Group {
    points: Points,
    base: [[f32; GROUP]; 3],
    /// Blocked shares of the sky and of the mirrored direction.
    hidden: [[f32; GROUP]; 2],
    /// Share of the lamp.
    visible: [f32; GROUP],
}

impl Kernel for Shade<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: F32x8>(self) {
        self.groups.resize(BATCH, Group::default());
        let (fragments, colors) = (self.fragments.as_chunks::<GROUP>().0, self.colors.as_chunks_mut::<GROUP>().0);
        for (fragments, colors) in fragments.chunks(BATCH).zip(colors.chunks_mut(BATCH)) {
            batch::<V>(self.scene, self.shading, self.eye, fragments, &mut self.groups[..fragments.len()], colors);
        }
    }
}

#[inline(always)]
fn batch<V: F32x8>(
    scene: &Triangles<'_>,
    shading: &Shading,
    eye: Vec3A,
    fragments: &[[Fragment; GROUP]],
    groups: &mut [Group],
    colors: &mut [[Vec3A; GROUP]],
) {
    let surfaces = &scene.geometry.surfaces;
    for (group, fragments) in groups.iter_mut().zip(fragments) {
        group.points.fill::<V>(scene, fragments);
        group.points.face::<V>(eye);
    }
    for group in groups.iter_mut() {
        base_color::<V>(&surfaces[group.points.surface], &group.points).store(&mut group.base);
    }
    if let Some(occlusion) = &shading.occlusion {
        for group in groups.iter_mut() {
            let seen = Seen::<V>::new(&group.points);
            let (sky, mirror) = occlusion.at(seen.position, seen.normal, seen.reflection());
            sky.store(&mut group.hidden[0]);
            mirror.store(&mut group.hidden[1]);
        }
    }
    if let Some(shadow) = &shading.shadow {
        for group in groups.iter_mut() {
            let seen = Seen::<V>::new(&group.points);
            let lit = shading.light.reaches(&seen);
            shadow.visibility(seen.position, seen.facet, lit).store(&mut group.visible);
        }
    }
    for (group, colors) in groups.iter().zip(colors) {
        let radiance = shading.reflected::<V>(group, &surfaces[group.points.surface]);
        let mut out = [[0.0; GROUP]; 3];
        shading.display(radiance).store(&mut out);
        for (i, color) in colors.iter_mut().enumerate() {
            *color = Vec3A::new(out[0][i], out[1][i], out[2][i]);
        }
    }
}

/// Linear base colours of eight points.
#[inline(always)]
fn base_color<V: F32x8>(surface: &Surface, points: &Points) -> V3<V> {
    let color = V3::splat(surface.base);
    match &surface.texture {
        Some(texture) => color * texture.sample(pair(&points.uv), pair(&points.du), pair(&points.dv)),
        None => color,
    }
}

#[inline(always)]
fn pair<V: F32x8>(p: &[[f32; GROUP]; 2]) -> [V; 2] {
    [V::load(&p[0]), V::load(&p[1])]
}

/// Where eight points are and how they are turned.
struct Seen<V> {
    position: V3<V>,
    /// Unit, towards the viewer's side.
    normal: V3<V>,
    /// Of the triangle, towards the viewer's side.
    facet: V3<V>,
    /// Unit, towards the eye.
    view: V3<V>,
}

impl<V: F32x8> Seen<V> {
    #[inline(always)]
    fn new(points: &Points) -> Self {
        Self {
            position: V3::load(&points.position),
            normal: V3::load(&points.normal),
            facet: V3::load(&points.facet),
            view: V3::load(&points.view),
        }
    }

    /// The direction that a mirror would show.
    #[inline(always)]
    fn reflection(&self) -> V3<V> {
        self.normal.scale(V::splat(2.0) * self.normal.dot(self.view)) - self.view
    }
}

impl Lamp {
    /// Unit directions to the lamp, and distances squared.
    #[inline(always)]
    fn from<V: F32x8>(&self, position: V3<V>) -> (V3<V>, V) {
        let to_light = V3::splat(self.position) - position;
        let distance2 = to_light.dot(to_light).max(V::splat(1e-4));
        (to_light.scale(V::splat(1.0) / distance2.sqrt()), distance2)
    }

    /// Which points face the lamp.
    #[inline(always)]
    fn reaches<V: F32x8>(&self, p: &Seen<V>) -> V {
        let to_light = V3::splat(self.position) - p.position;
        p.normal.dot(to_light).gt(V::zero()).and(p.facet.dot(to_light).gt(V::zero()))
    }
}

impl Shading {
    pub fn new(light: &Light, shadow: Option<Shadow>, occlusion: Option<Occlusion>) -> Self {
        Self { light: Lamp::new(light), shadow, occlusion, encode: SrgbTable::new() }
    }

    /// Radiance towards the viewer.
    #[inline(always)]
    fn reflected<V: F32x8>(&self, group: &Group, surface: &Surface) -> V3<V> {
        let one = V::splat(1.0);
        let p = Seen::<V>::new(&group.points);
        let (metallic, roughness) = (V::splat(surface.metallic), V::splat(surface.roughness));
        let base = V3::load(&group.base);
        let f0 = V3::all(V::splat(0.04)).lerp(base, metallic);
        let diffuse = base.scale(one - metallic);
        let nv = p.normal.dot(p.view).max(V::splat(1e-3));
        let [hidden, hidden_mirror] = pair(&group.hidden);
        let mirror = environment_brdf(f0, roughness, nv) * self.surroundings(p.reflection(), roughness);
        let ambient = (diffuse * self.irradiance(p.normal)).scale(one - hidden) + mirror.scale(one - hidden_mirror);
        let visible = if self.shadow.is_some() { V::load(&group.visible) } else { one };
        ambient + self.key(&p, diffuse, f0, nv, roughness, visible)
    }

    /// Light from the key lamp: Lambert and GGX, the lamp's size widening the highlight.
    #[inline(always)]
    fn key<V: F32x8>(&self, p: &Seen<V>, diffuse: V3<V>, f0: V3<V>, nv: V, roughness: V, visible: V) -> V3<V> {
        let (zero, one) = (V::zero(), V::splat(1.0));
        let lit = self.light.reaches(p);
        if lit.mask_bits() == 0 {
            return V3::all(zero);
        }
        let (l, distance2) = self.light.from(p.position);
        let distance = distance2.sqrt();
        let nl = p.normal.dot(l);
        let h = (l + p.view).normalize_or(p.normal);
        let (nh, vh) = (clamp(p.normal.dot(h), 0.0, 1.0), clamp(p.view.dot(h), 0.0, 1.0));
        let alpha = roughness * roughness;
        let wide = (alpha + V::splat(0.5 * self.light.radius) / distance).min(one);
        let a2 = wide * wide;
        let d = nh * nh * (a2 - one) + one;
        // GGX times π, since `intensity` is over π.
        let distribution = a2 / (d * d).max(V::splat(1e-8));
        let k = alpha * V::splat(0.5);
        let visibility = V::splat(0.25) / ((nl * (one - k) + k) * (nv * (one - k) + k)).max(V::splat(1e-12));
        let f = (one - vh) * (one - vh);
        let fresnel = f0 + (V3::all(one) - f0).scale(f * f * (one - vh));
        let reflected = diffuse + fresnel.scale(distribution * visibility);
        let strength = (visible * nl / distance2).and(lit);
        reflected * V3::splat(self.light.intensity).scale(strength)
    }

    /// Ambient irradiance over π on surfaces with these normals.
    #[inline(always)]
    fn irradiance<V: F32x8>(&self, n: V3<V>) -> V3<V> {
        let half = V::splat(0.5);
        let mut sum = V3::splat(self.light.ground).lerp(V3::splat(self.light.sky), half + half * n.z);
        for b in &self.light.soft_boxes {
            // The patch's solid angle is 2π/s (1 - 1/(1 + 2s)) ≈ 2π/s; the cosine is wrapped.
            let c = (half + half * n.dot(V3::splat(b.direction))).max(V::zero());
            sum = sum + V3::splat(b.color * (2.0 / (1.0 + b.sharpness))).scale(c * c);
        }
        sum
    }

    /// Ambient radiance from directions, blurred as surfaces of this roughness see it.
    #[inline(always)]
    fn surroundings<V: F32x8>(&self, d: V3<V>, roughness: V) -> V3<V> {
        let one = V::splat(1.0);
        let t = clamp(V::splat(0.5) + d.z / (V::splat(0.3) + V::splat(1.7) * roughness), 0.0, 1.0);
        let sky = V3::splat(self.light.sky);
        let mut sum = V3::splat(self.light.ground).lerp(sky, t * t * (V::splat(3.0) - V::splat(2.0) * t));
        // Walls are brighter than floor and ceiling, which see the lamp at a steeper angle.
        let level = one - d.z * d.z;
        sum = sum + sky.scale(V::splat(0.7) * level * level);
        let a = roughness * roughness;
        for b in &self.light.soft_boxes {
            let sharpness = V::splat(b.sharpness);
            let s = sharpness / (one + sharpness * a);
            let lobe = one / (one + s * (one - d.dot(V3::splat(b.direction))));
            sum = sum + V3::splat(b.color / (1.0 + b.sharpness)).scale(lobe * lobe * (one + s));
        }
        sum
    }

    /// Exposure and tone curve: neutral below 0.76, smooth shoulder above (Khronos PBR neutral,
    /// without its toe), in [0, 1].
    #[inline(always)]
    fn display<V: F32x8>(&self, radiance: V3<V>) -> V3<V> {
        let (zero, one) = (V::zero(), V::splat(1.0));
        let c = radiance.scale(V::splat(self.light.exposure));
        let peak = c.max_element();
        let low = V3 { x: c.x.max(zero), y: c.y.max(zero), z: c.z.max(zero) };
        let bright = peak.ge(V::splat(TONE_START));
        if bright.mask_bits() == 0 {
            return low;
        }
        let d = V::splat(1.0 - TONE_START);
        let new_peak = one - d * d / (peak.max(V::splat(TONE_START)) + d - V::splat(TONE_START));
        let g = one - one / (V::splat(TONE_DESATURATION) * (peak - new_peak).max(zero) + one);
        let high = c.scale(new_peak / peak.max(V::splat(TONE_START))).lerp(V3::all(new_peak), g);
        let high = V3 { x: clamp(high.x, 0.0, 1.0), y: clamp(high.y, 0.0, 1.0), z: clamp(high.z, 0.0, 1.0) };
        high.select(bright, low)
    }

    /// The same for one colour.
    pub fn display_one(&self, radiance: Vec3A) -> Vec3A {
        struct Display<'a>(&'a Shading, Vec3A);
        impl Kernel for Display<'_> {
            type Output = Vec3A;
            #[inline(always)]
            fn run<V: F32x8>(self) -> Vec3A {
                let c = self.0.display(V3::<V>::splat(self.1));
                Vec3A::new(c.x.to_array()[0], c.y.to_array()[0], c.z.to_array()[0])
            }
        }
        dispatch(Level::Portable, Display(self, radiance))
    }
}

/// Split-sum environment reflectance, analytic fit (Karis, "Physically based shading on
/// mobile", 2014).
#[inline(always)]
fn environment_brdf<V: F32x8>(f0: V3<V>, roughness: V, nv: V) -> V3<V> {
    let r = [
        V::splat(1.0) - roughness,
        roughness * V::splat(-0.0275) + V::splat(0.0425),
        roughness * V::splat(-0.572) + V::splat(1.04),
        roughness * V::splat(0.022) - V::splat(0.04),
    ];
    let (a, edge) = (r[0] * r[0], V::splat(1.0) - nv);
    // The fit's 2^(-9.28 nv) is replaced by (1 - nv)⁵: no library call, the same bits anywhere.
    let edge = edge * edge * edge * edge * edge;
    let a004 = a.min(edge) * r[0] + r[1];
    let (scale, bias) = (V::splat(-1.04) * a004 + r[2], V::splat(1.04) * a004 + r[3]);
    f0.scale(scale) + V3::all(bias)
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

    #[inline]
    pub fn encode(&self, c: Vec3A) -> [u8; 3] {
        let c = c * (Self::SIZE - 1) as f32 + Vec3A::splat(0.5);
        let byte = |v: f32| self.0[(v as usize).min(Self::SIZE - 1)];
        [byte(c.x), byte(c.y), byte(c.z)]
    }
}
