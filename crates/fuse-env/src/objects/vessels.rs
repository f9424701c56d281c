//! Mugs and bowls.

use glam::{Vec2, Vec3};

use super::Workshop;
use super::finish::{ceramic, glaze, plastic, steel, wood};
use super::shape::Surface;
use super::sweep::{Tip, hollow, revolve, spline, tube};

/// Texture coordinates of a vessel: u around, v from the rim down to the foot.
pub fn around(surface: Surface, height: f32) -> Surface {
    surface.map_uv(move |p, uv| Vec2::new(uv.x, 1.0 - (p.z / height).clamp(0.0, 1.0)))
}

/// Where a handle meets a body of revolution: heights of its upper and lower root, radii at which
/// it ends.
pub struct Roots<'a> {
    /// The body's outer profile.
    pub outer: &'a [Vec2],
    /// How deep the handle reaches into the body, metres.
    pub into: f32,
    /// Heights of the upper and the lower root, metres.
    pub z: (f32, f32),
    /// Height of the body, for texture coordinates.
    pub height: f32,
}

/// A C-, D- or ear-shaped handle in the plane of x and z that reaches `out` metres beyond its
/// roots; `square` squares it.
pub fn handle(roots: &Roots<'_>, out: f32, square: f32, thick: f32, wide: f32) -> Surface {
    let radius = |z: f32| profile_radius(roots.outer, z) - roots.into;
    let at = |p: Vec2| Vec3::new(p.x, 0.0, p.y);
    let [top, low] = [roots.z.0, roots.z.1].map(|z| Vec2::new(radius(z), z));
    let down = low.y - top.y;
    let far = top.x.max(low.x) + out;
    let path = spline(
        &[
            at(top),
            at(Vec2::new(top.x + out * (0.45 + 0.3 * square), top.y - down * 0.03)),
            at(Vec2::new(far, top.y + down * (0.24 - 0.12 * square))),
            at(Vec2::new(far * (0.985 + 0.015 * square), top.y + down * (0.62 + 0.16 * square))),
            at(Vec2::new(low.x + out * (0.42 + 0.3 * square), low.y + down * 0.01)),
            at(low),
        ],
        5,
    );
    let ear = tube(&path, Vec3::Y, 12, [Tip::Flat, Tip::Flat], |t| {
        let flare = 1.0 + 0.35 * (2.0 * t - 1.0).abs().powi(6);
        (thick * flare, wide * flare)
    });
    // Nothing of it may come out on the other side of the wall.
    let ear = ear.map(|p| {
        let (r, least) = (p.truncate().length(), radius(p.z));
        if r < least { (p.truncate() * (least / r.max(1e-6))).extend(p.z) } else { p }
    });
    around(ear, roots.height)
}

/// A mug with a handle and a hollow inside.
pub fn mug(w: &mut Workshop) {
    let shape = w.shape();
    let height = w.dice.range(0.080, 0.112);
    let radius = w.dice.range(0.036, 0.046);
    let (foot, belly, rim) = match shape {
        "cylinder" => (0.97, 1.0, 1.0),
        "tapered" => (w.dice.range(0.70, 0.84), w.dice.range(0.86, 0.92), 1.0),
        "barrel" => (w.dice.range(0.72, 0.85), w.dice.range(1.05, 1.13), w.dice.range(0.90, 0.98)),
        "waisted" => (1.0, 0.88, 1.0),
        "flared" => (0.68, 0.80, 1.08),
        _ => (0.62, 1.04, 1.0),
    };
    let r = radius;
    let round = w.dice.any(0.02, 0.09);
    let outer = spline(
        &[
            Vec2::new(r * foot * (1.0 - round), 0.0),
            Vec2::new(r * foot, height * (0.03 + round * 0.5)),
            Vec2::new(r * (foot * 0.45 + belly * 0.55), height * 0.25),
            Vec2::new(r * belly, height * 0.52),
            Vec2::new(r * (belly * 0.4 + rim * 0.6), height * 0.82),
            Vec2::new(r * rim, height),
        ],
        4,
    );
    let wall = w.dice.range(0.0030, 0.0050);
    let body = around(revolve(&hollow(&outer, wall, wall * 1.6), 40), height);
    let (inside, outside) = body.split(|c, n| {
        let out = Vec3::new(c.x, c.y, 0.0).normalize_or_zero();
        n.dot(out) < -0.2 || n.z > 0.7
    });
    let metal = w.dice.chance(0.08);
    let skin = if metal { w.material(steel) } else { w.material(ceramic) };
    w.add(outside, skin, 50.0);
    let lining = if metal {
        skin
    } else {
        let tone = if w.dice.chance(0.6) {
            w.dice.color((0.0, 0.08), (0.86, 0.96))
        } else {
            w.dice.color((0.3, 0.7), (0.4, 0.8))
        };
        w.material(|_| glaze(tone))
    };
    w.add(inside, lining, 50.0);
    let z = (height * w.dice.range(0.80, 0.88), height * w.dice.range(0.16, 0.28));
    let (thick, wide) = (w.dice.range(0.0034, 0.0050), w.dice.range(0.0055, 0.0085));
    let out = w.dice.range(0.024, 0.034);
    let roots = Roots { outer: &outer, into: wall * 0.5, z, height };
    let ear = handle(&roots, out, w.dice.range(0.0, 1.0), thick, wide);
    let stuff = if w.dice.chance(0.8) { skin } else { lining };
    w.add(ear, stuff, 60.0);
    w.settle();
}

/// Radius of an outer profile at a height.
pub fn profile_radius(outer: &[Vec2], z: f32) -> f32 {
    outer
        .windows(2)
        .find(|p| p[0].y <= z && z <= p[1].y)
        .map_or(outer[outer.len() - 1].x, |p| p[0].x + (p[1].x - p[0].x) * (z - p[0].y) / (p[1].y - p[0].y).max(1e-6))
}

/// A hollow bowl on a foot ring.
pub fn bowl(w: &mut Workshop) {
    let shape = w.shape();
    let radius = w.dice.range(0.062, 0.095);
    let height = radius
        * match shape {
            "deep" => w.dice.range(0.95, 1.12),
            "straight" => w.dice.range(0.62, 0.75),
            _ => w.dice.range(0.66, 0.92),
        };
    let foot = radius * w.dice.range(0.42, 0.56);
    let ring = height * w.dice.any(0.06, 0.11);
    let mids: [(f32, f32); 3] = match shape {
        "conic" => [(0.22, 0.62), (0.48, 0.78), (0.76, 0.91)],
        "straight" => [(0.10, 0.84), (0.35, 0.96), (0.7, 0.99)],
        "bell" => [(0.20, 0.66), (0.5, 0.82), (0.82, 0.88)],
        "rimmed" => [(0.22, 0.66), (0.55, 0.80), (0.88, 0.85)],
        _ => [(0.18, 0.70), (0.42, 0.88), (0.72, 0.97)],
    };
    let mut controls = vec![Vec2::new(foot, 0.0), Vec2::new(foot * 0.99, ring)];
    controls.extend(mids.iter().map(|&(z, r)| Vec2::new(radius * r, height * z.max(ring / height + 0.03))));
    controls.push(Vec2::new(radius, height));
    let outer = spline(&controls, 4);
    let wall = w.dice.range(0.0032, 0.0055);
    let body = around(revolve(&hollow(&outer, wall, ring + wall), 44), height);
    let (inside, outside) = body.split(|c, n| {
        let out = Vec3::new(c.x, c.y, 0.0).normalize_or_zero();
        n.dot(out) < -0.1 || n.z > 0.75
    });
    let kind = w.dice.unit();
    let skin = if kind < 0.70 {
        w.material(ceramic)
    } else if kind < 0.80 {
        w.material(steel)
    } else if kind < 0.90 {
        w.material(wood)
    } else {
        let tone = w.dice.vivid();
        w.material(|d| plastic(d, tone))
    };
    let lining = if kind < 0.70 && w.dice.chance(0.7) {
        let tone = if w.dice.chance(0.6) {
            w.dice.color((0.0, 0.1), (0.85, 0.96))
        } else {
            w.dice.color((0.3, 0.7), (0.4, 0.8))
        };
        w.material(|_| glaze(tone))
    } else {
        skin
    };
    // What has a grain or scratches shows them at their true size.
    let flat = |s: Surface| if kind >= 0.70 { s.uv_box(Vec2::new(0.10, 0.20)) } else { s };
    w.add(flat(outside), skin, 50.0);
    w.add(flat(inside), lining, 50.0);
    w.settle();
}
