//! On the shipped objects.

use std::path::Path;

use rapier3d::geometry::PointQuery;
use rayon::prelude::*;

use super::*;
use crate::catalogue::Catalogue;

/// By how much the engine's distances may be wrong, metres.
const ROUNDING: f32 = 1e-5;

#[test]
fn every_piece_of_every_shipped_object_holds_its_points() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python/fuse_grounding/data/objects");
    let catalogue = Catalogue::load(data).unwrap();
    assert_eq!(catalogue.records().len(), 360);
    let lost: Vec<String> = catalogue
        .records()
        .par_iter()
        .flat_map_iter(|record| {
            let model = catalogue.model(record).unwrap();
            let cavity = Solid::new(&model).unwrap().cavity;
            pieces(&parts(&model), cavity).into_iter().enumerate().filter_map(move |(i, points)| {
                let shape = polyhedron(&points).unwrap();
                let off = points.iter().map(|p| shape.distance_to_local_point(*p, true)).fold(0.0, f32::max);
                (off > compound::TOLERANCE + compound::LOST + ROUNDING)
                    .then(|| format!("{}: a point is {off} m outside of piece {i}", record.id))
            })
        })
        .collect();
    assert!(lost.is_empty(), "{}", lost.join("\n"));
}
