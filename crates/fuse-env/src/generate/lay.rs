//! Where the things of an episode lie.

use glam::Vec2;
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::catalogue::ObjectRecord;
use crate::configuration::SceneConfiguration;
use crate::episode::{EpisodeObject, Quaternion};
use crate::placement::{self, Item, Placed, Rest, Surface};
use crate::world::{Stage, WorldError};

fn object(instance_id: u32, record: &ObjectRecord, placed: &Placed) -> EpisodeObject {
    let q = placed.rotation;
    EpisodeObject {
        instance_id,
        model_id: record.id.clone(),
        category: record.category,
        translation: placed.translation.to_array(),
        rotation: Quaternion { w: q.w, x: q.x, y: q.y, z: q.z },
    }
}

/// Lays the chosen things out, tall ones right after the target so that they come close to it.
pub(super) fn lay(
    stage: &Stage,
    scene: &SceneConfiguration,
    mut records: Vec<&ObjectRecord>,
    rng: &mut ChaCha8Rng,
) -> Result<Result<Vec<EpisodeObject>, &'static str>, WorldError> {
    records[1..].sort_by(|a, b| b.size_m[2].total_cmp(&a.size_m[2]));
    let models = records.iter().map(|r| stage.model(&r.id)).collect::<Result<Vec<_>, _>>()?;
    let rests: Vec<Vec<Rest>> = records
        .iter()
        .map(|r| r.resting.iter().map(|p| Rest { rotation: p.rotation(), probability: p.probability }).collect())
        .collect();
    let items: Vec<Item<'_>> =
        models.iter().zip(&rests).map(|(model, rests)| Item { model: model.as_ref(), rests }).collect();
    let mut surface = Surface::of(scene);
    // The heap is not always in the middle of the table.
    surface.center += Vec2::from_angle(rng.random_range(0.0..std::f32::consts::TAU)) * surface.extent * 0.15;
    let Ok(placed) = placement::place(&items, &surface, rng) else { return Ok(Err("no room on the table")) };
    let mut ids: Vec<u32> = (1..=records.len() as u32).collect();
    ids.shuffle(rng);
    let objects = records.iter().zip(&placed).zip(ids).map(|((r, p), id)| object(id, r, p)).collect();
    Ok(Ok(objects))
}
