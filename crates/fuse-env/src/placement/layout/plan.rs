//! Which things a clutter style puts in, on or against which others.

use glam::Quat as Rotation;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rapier3d::glamx::Vec3;

use crate::catalogue::Category;
use crate::configuration::ClutterStyle;
use crate::placement::solid::Solid;
use crate::placement::{Item, Rest};

/// Most things in, on and against one host.
const CAPACITY: [usize; 3] = [3, 2, 2];
/// Most things on a tray.
const TRAY_CAPACITY: usize = 6;
/// Chance that a thing which could go to a host goes there.
const CHANCE: f64 = 0.75;

/// A thing to be laid out.
#[derive(Clone, Copy, Debug)]
pub struct Thing<'a> {
    /// What it is.
    pub category: Category,
    /// Its model and how it may rest on a plane.
    pub item: Item<'a>,
    /// Its body.
    pub solid: &'a Solid,
}

/// What holds a thing that does not stand on the table alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// Upright in a vessel.
    In(usize),
    /// On top of something, or in something shallow.
    On(usize),
    /// Leaning against something.
    Against(usize),
}

impl Thing<'_> {
    /// The longest axis, its extent and the second extent, metres.
    pub(super) fn length(&self) -> (usize, f32, f32) {
        let size = self.solid.size().to_array();
        let mut order = [0, 1, 2];
        order.sort_by(|&i, &j| size[j].total_cmp(&size[i]));
        (order[0], size[order[0]], size[order[1]])
    }

    /// Whether it is long and thin enough to stand in something or to lean.
    pub fn is_slender(&self) -> bool {
        let (_, long, second) = self.length();
        long > 0.12 && long > 2.2 * second && second < 0.09
    }

    /// Whether a slender thing finds room and support inside.
    pub fn is_container(&self) -> bool {
        use Category as C;
        let vessel = matches!(self.category, C::Mug | C::Pitcher | C::MeasuringCup | C::Can);
        vessel && self.solid.cavity.is_some_and(|c| c.rim - c.floor > 0.05 && c.radius > 0.018)
    }

    /// Whether others can be put on it.
    pub fn is_carrier(&self) -> bool {
        use Category as C;
        matches!(self.category, C::Plate | C::Tray | C::Book | C::Bowl | C::Towel | C::Colander)
    }

    /// Whether something can lean against it.
    pub fn is_support(&self) -> bool {
        let size = self.solid.size();
        size.z > 0.055 && size.x.min(size.y) > 0.045 && self.solid.mass.mass() > 0.09
    }

    /// The rotation in which it stands as it was made to.
    pub(super) fn upright(&self) -> Rest {
        let up = |r: &Rest| {
            let q = r.rotation;
            1.0 - 2.0 * (q.x * q.x + q.y * q.y)
        };
        let best = self.item.rests.iter().copied().max_by(|a, b| up(a).total_cmp(&up(b)));
        best.unwrap_or(Rest { rotation: Rotation::IDENTITY, probability: 1.0 })
    }
}

/// What shall hold each thing; the first, the target, is never put into a vessel, which would hide
/// half of it from everywhere.
pub(super) fn plan(style: ClutterStyle, things: &[Thing<'_>], rng: &mut ChaCha8Rng) -> Vec<Option<Hold>> {
    let mut holds: Vec<Option<Hold>> = vec![None; things.len()];
    let mut load = vec![0; things.len()];
    for i in 0..things.len() {
        if holds[i].is_some() || load[i] > 0 {
            continue;
        }
        let hosts: Vec<usize> = (0..things.len())
            .filter(|&h| {
                h != i
                    && !matches!(holds[h], Some(Hold::In(_) | Hold::Against(_)))
                    && load[h] < capacity(style, &things[h])
            })
            .filter(|&h| fits(style, i, &things[i], &things[h]) && !under(&holds, h, i))
            .collect();
        if hosts.is_empty() || !rng.random_bool(CHANCE) {
            continue;
        }
        let h = hosts[rng.random_range(0..hosts.len())];
        load[h] += 1;
        holds[i] = Some(match style {
            ClutterStyle::InContainers => Hold::In(h),
            ClutterStyle::Leaning => Hold::Against(h),
            _ => Hold::On(h),
        });
    }
    holds
}

fn capacity(style: ClutterStyle, host: &Thing<'_>) -> usize {
    match style {
        ClutterStyle::InContainers => CAPACITY[0],
        ClutterStyle::OnTray => TRAY_CAPACITY,
        ClutterStyle::Stacked if host.category == Category::Tray => CAPACITY[1] + 1,
        ClutterStyle::Stacked => CAPACITY[1],
        _ => CAPACITY[2],
    }
}

/// Whether a thing may go to a host in a style.
fn fits(style: ClutterStyle, index: usize, thing: &Thing<'_>, host: &Thing<'_>) -> bool {
    let flat = |t: &Thing<'_>| {
        let s = t.solid.size();
        (s.x.max(s.y), s.x.min(s.y))
    };
    let ((long, short), (host_long, host_short)) = (flat(thing), flat(host));
    match style {
        ClutterStyle::Sparse | ClutterStyle::Packed => false,
        ClutterStyle::InContainers => {
            let Some(c) = host.solid.cavity else { return false };
            let (_, length, second) = thing.length();
            let narrow = thing.narrow_end().1;
            index > 0
                && host.is_container()
                && thing.is_slender()
                && length > 1.25 * (c.rim - c.floor)
                && length < 3.4 * (c.rim - c.floor)
                && narrow < 1.2 * c.radius
                && second < 4.0 * c.radius
        }
        ClutterStyle::Leaning => {
            thing.is_slender()
                && host.is_support()
                && thing.length().1 > 1.35 * host.solid.size().z
                && !host.is_slender()
        }
        ClutterStyle::OnTray => host.category == Category::Tray && long < 1.05 * host_long && short < 0.8 * host_short,
        ClutterStyle::Stacked => {
            let same = thing.category == host.category;
            host.is_carrier()
                && long < 1.2 * host_long
                && (same || short < 0.75 * host_short)
                && thing.solid.size().z < 0.2
        }
    }
}

/// Whether `h` rests, through others, on `i`.
fn under(holds: &[Option<Hold>], mut h: usize, i: usize) -> bool {
    while let Some(Hold::On(next) | Hold::In(next) | Hold::Against(next)) = holds[h] {
        if next == i {
            return true;
        }
        h = next;
    }
    h == i
}

impl Thing<'_> {
    /// The end of the long axis where the thing is thinner, as a direction, and its girth there.
    pub(super) fn narrow_end(&self) -> (Vec3, f32) {
        let (axis, long, _) = self.length();
        let [low, high] = self.solid.bounds;
        let girth = |near_low: bool| {
            let inside = |p: &&Vec3| {
                let along = (p[axis] - low[axis]) / long;
                if near_low { along < 0.45 } else { along > 0.55 }
            };
            let (l, h) = self.solid.samples.iter().filter(inside).fold((high, low), |(l, h), p| (l.min(*p), h.max(*p)));
            let mut size = (h - l).max(Vec3::ZERO);
            size[axis] = 0.0;
            size.max_element()
        };
        let mut end = Vec3::ZERO;
        let (low_girth, high_girth) = (girth(true), girth(false));
        end[axis] = if low_girth <= high_girth { -1.0 } else { 1.0 };
        (end, low_girth.min(high_girth))
    }

    /// The end of the long axis that is nearer to the centre of mass.
    pub(super) fn heavy_end(&self) -> Vec3 {
        let (axis, ..) = self.length();
        let middle = (self.solid.bounds[0] + self.solid.bounds[1]) / 2.0;
        let mut end = Vec3::ZERO;
        end[axis] = if self.solid.mass.local_com[axis] <= middle[axis] { -1.0 } else { 1.0 };
        end
    }
}
