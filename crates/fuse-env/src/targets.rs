//! What the 108 viewpoints see of each target: pixels, visible share, distance.

use fuse_render::Renderer;
use nalgebra::Point3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::ring::{Ring, Viewpoint};

/// What the viewpoints see of one object; lists are by [`Viewpoint::index`], counts at 640×480.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetStatistics {
    /// Instance id.
    pub instance_id: u32,
    /// Middle of its bounding box, world metres.
    pub position_m: [f64; 3],
    /// Most visible pixels over the viewpoints.
    pub pixels_max: u32,
    /// Fewest visible pixels over the viewpoints.
    pub pixels_min: u32,
    /// Smallest distance camera to position, metres.
    pub distance_min_m: f64,
    /// Largest distance camera to position, metres.
    pub distance_max_m: f64,
    /// Pixels that show it.
    pub visible_px: Vec<u32>,
    /// Pixels that would show it if it stood alone.
    pub unoccluded_px: Vec<u32>,
}

impl TargetStatistics {
    /// Visible over unoccluded pixels; 0 where it is out of the picture.
    pub fn fraction(&self, viewpoint: Viewpoint) -> f32 {
        let i = viewpoint.index();
        if self.unoccluded_px[i] == 0 { 0.0 } else { self.visible_px[i] as f32 / self.unoccluded_px[i] as f32 }
    }

    /// Whether some viewpoint shows at least `pixels` of it and at least `fraction` of what could be
    /// seen of it from there.
    pub fn well_seen(&self, pixels: u32, fraction: f32) -> bool {
        Viewpoint::all().any(|v| self.visible_px[v.index()] >= pixels && self.fraction(v) >= fraction)
    }
}

/// Statistics of the objects `(instance id, middle)`, from exact counts at 640×480.
pub fn statistics(renderer: &Renderer, ring: &Ring, objects: &[(u32, Point3<f64>)]) -> Vec<TargetStatistics> {
    counted(renderer, ring, objects, 1)
}

/// As [`statistics`], from every fourth row and column and scaled up: to see soon that a layout will
/// not do.
pub fn estimate(renderer: &Renderer, ring: &Ring, objects: &[(u32, Point3<f64>)]) -> Vec<TargetStatistics> {
    counted(renderer, ring, objects, 4)
}

fn counted(renderer: &Renderer, ring: &Ring, objects: &[(u32, Point3<f64>)], coarse: u32) -> Vec<TargetStatistics> {
    let views: Vec<Viewpoint> = Viewpoint::all().collect();
    let look = |v: &Viewpoint| {
        let mut camera = ring.camera(*v);
        let (k, by) = (&mut camera.intrinsics, f64::from(coarse));
        (k.width, k.height) = (k.width / coarse, k.height / coarse);
        (k.fx, k.fy, k.cx, k.cy) = (k.fx / by, k.fy / by, k.cx / by, k.cy / by);
        renderer.amodal_all(&camera)
    };
    let counts: Vec<_> = views.par_iter().map(look).collect();
    objects
        .iter()
        .map(|(id, position)| {
            let of = |pick: fn(&fuse_render::Amodal) -> u32| -> Vec<u32> {
                counts.iter().map(|all| all.iter().find(|a| a.id == *id).map_or(0, pick) * coarse * coarse).collect()
            };
            let visible_px = of(|a| a.visible_px);
            let distances = views.iter().map(|v| nalgebra::distance(&ring.camera(*v).pose.center(), position));
            TargetStatistics {
                instance_id: *id,
                position_m: [position.x, position.y, position.z],
                pixels_max: visible_px.iter().copied().max().unwrap_or(0),
                pixels_min: visible_px.iter().copied().min().unwrap_or(0),
                distance_min_m: distances.clone().fold(f64::MAX, f64::min),
                distance_max_m: distances.fold(0.0, f64::max),
                visible_px,
                unoccluded_px: of(|a| a.unoccluded_px),
            }
        })
        .collect()
}
