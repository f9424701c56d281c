//! What the 108 viewpoints see of each target: pixels, visible share, distance; and how many moves away the
//! first good view is.

use fuse_render::Renderer;
use nalgebra::Point3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::episode::{GOOD_FRACTION, GOOD_PX, MOST_MOVES};
use crate::ring::{Ring, VIEWPOINTS, Viewpoint};

/// What the viewpoints see of one object; lists are by [`Viewpoint::index`], counts at 640×480.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetStatistics {
    /// Instance id.
    pub instance_id: u32,
    /// Middle of its bounding box, world metres.
    pub position_m: [f64; 3],
    /// `P_max`: most visible pixels over the viewpoints.
    pub pixels_max: u32,
    /// `P_min`: fewest visible pixels over the viewpoints.
    pub pixels_min: u32,
    /// `D_min`: smallest distance camera to position, metres.
    pub distance_min_m: f64,
    /// `D_max`: largest distance camera to position, metres.
    pub distance_max_m: f64,
    /// Pixels that show it.
    pub visible_px: Vec<u32>,
    /// Pixels that would show it if it stood alone.
    pub unoccluded_px: Vec<u32>,
    /// Visible over unoccluded pixels, rounded to four decimals; 0 where it is out of the picture.
    pub visible_fraction: Vec<f64>,
}

/// Visible over unoccluded pixels; 0 where the object is out of the picture.
fn share(visible: u32, unoccluded: u32) -> f32 {
    if unoccluded == 0 { 0.0 } else { visible as f32 / unoccluded as f32 }
}

/// Four decimals: a pixel of the largest object is more.
fn rounded(fraction: f32) -> f64 {
    (f64::from(fraction) * 1e4).round() / 1e4
}

impl TargetStatistics {
    fn new(
        instance_id: u32,
        position: &Point3<f64>,
        ring: &Ring,
        visible_px: Vec<u32>,
        unoccluded_px: Vec<u32>,
    ) -> Self {
        let away = |v| nalgebra::distance(&ring.camera(v).pose.center(), position);
        let visible_fraction = visible_px.iter().zip(&unoccluded_px).map(|(v, u)| rounded(share(*v, *u))).collect();
        Self {
            instance_id,
            position_m: [position.x, position.y, position.z],
            pixels_max: visible_px.iter().copied().max().unwrap_or(0),
            pixels_min: visible_px.iter().copied().min().unwrap_or(0),
            distance_min_m: Viewpoint::all().map(away).fold(f64::MAX, f64::min),
            distance_max_m: Viewpoint::all().map(away).fold(0.0, f64::max),
            visible_px,
            unoccluded_px,
            visible_fraction,
        }
    }

    /// Visible over unoccluded pixels; 0 where it is out of the picture.
    pub fn fraction(&self, viewpoint: Viewpoint) -> f32 {
        share(self.visible_px[viewpoint.index()], self.unoccluded_px[viewpoint.index()])
    }

    /// Whether the viewpoint shows at least `pixels` of it and at least `fraction` of what could be seen from there.
    pub fn well_seen(&self, viewpoint: Viewpoint, pixels: u32, fraction: f32) -> bool {
        self.visible_px[viewpoint.index()] >= pixels && self.fraction(viewpoint) >= fraction
    }

    /// Checks that the lists are complete and say the same as one another.
    pub fn check(&self) -> Result<(), String> {
        let id = self.instance_id;
        let lengths = [self.visible_px.len(), self.unoccluded_px.len(), self.visible_fraction.len()];
        if lengths != [VIEWPOINTS; 3] {
            return Err(format!("statistics of {id} must have {VIEWPOINTS} views, found {lengths:?}"));
        }
        let extremes = (self.visible_px.iter().min().copied(), self.visible_px.iter().max().copied());
        if extremes != (Some(self.pixels_min), Some(self.pixels_max)) {
            return Err(format!("statistics of {id}: pixels_min and pixels_max are not those of visible_px"));
        }
        for (i, (v, u)) in self.visible_px.iter().zip(&self.unoccluded_px).enumerate() {
            let fraction = rounded(share(*v, *u));
            if v > u || (fraction - self.visible_fraction[i]).abs() > 1e-9 {
                let found = self.visible_fraction[i];
                return Err(format!("statistics of {id}: view {i} shows {v} of {u} pixels, found a share of {found}"));
            }
        }
        let numbers = [self.distance_min_m, self.distance_max_m, self.position_m[0], self.position_m[1]];
        if !numbers.iter().chain(&self.position_m).all(|v| v.is_finite()) || self.distance_min_m > self.distance_max_m {
            return Err(format!("statistics of {id}: distances and position must be finite, the least first"));
        }
        Ok(())
    }
}

/// The view that shows most of a target among those that show it well, and the way to the nearest of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GoodView {
    /// The good view with the most pixels, the first by index where there are several.
    pub best: Viewpoint,
    /// Fewest actions from the start to any good view.
    pub moves: u32,
}

/// The good views that the actions reach from `start`: at least [`GOOD_PX`] and [`GOOD_FRACTION`] of the target.
pub fn good_view(target: &TargetStatistics, start: Viewpoint) -> Option<GoodView> {
    let moves = start.moves_to_all();
    let reachable = |v: &Viewpoint| moves[v.index()] <= MOST_MOVES;
    let good = || Viewpoint::all().filter(|v| target.well_seen(*v, GOOD_PX, GOOD_FRACTION)).filter(reachable);
    let best = good().min_by_key(|v| (std::cmp::Reverse(target.visible_px[v.index()]), v.index()))?;
    let moves = good().map(|v| moves[v.index()]).min()?;
    Some(GoodView { best, moves })
}

/// Pixels that show each of `ids`, by view and then by id, from every `coarse`-th row and column and scaled up.
pub fn count(renderer: &Renderer, ring: &Ring, views: &[Viewpoint], ids: &[u32], coarse: u32) -> Vec<Vec<u32>> {
    let look = |v: &Viewpoint| {
        let mut camera = ring.camera(*v);
        let (k, by) = (&mut camera.intrinsics, f64::from(coarse));
        (k.width, k.height) = (k.width / coarse, k.height / coarse);
        (k.fx, k.fy, k.cx, k.cy) = (k.fx / by, k.fy / by, k.cx / by, k.cy / by);
        let (_, seen) = renderer.depth_ids(&camera);
        let mut counts = vec![0; ids.len()];
        for id in seen.as_slice().iter().filter(|id| **id != 0) {
            if let Some(k) = ids.iter().position(|i| i == id) {
                counts[k] += coarse * coarse;
            }
        }
        counts
    };
    views.par_iter().map(look).collect()
}

/// An object whose views are counted.
pub struct Subject {
    /// Instance id in the whole scene.
    pub id: u32,
    /// Middle of its bounding box, world metres.
    pub middle: Point3<f64>,
    /// A scene in which it stands alone, without the room.
    pub alone: Renderer,
}

/// Exact statistics of the subjects; `whole` shows the whole scene.
pub fn statistics(whole: &Renderer, ring: &Ring, subjects: &[Subject]) -> Vec<TargetStatistics> {
    let views: Vec<Viewpoint> = Viewpoint::all().collect();
    let ids: Vec<u32> = subjects.iter().map(|s| s.id).collect();
    let visible = count(whole, ring, &views, &ids, 1);
    let of = |(k, subject): (usize, &Subject)| {
        let alone = count(&subject.alone, ring, &views, &[subject.id], 1);
        let seen = visible.iter().map(|counts| counts[k]).collect();
        let unoccluded = alone.into_iter().map(|counts| counts[0]).collect();
        TargetStatistics::new(subject.id, &subject.middle, ring, seen, unoccluded)
    };
    subjects.iter().enumerate().map(of).collect()
}
