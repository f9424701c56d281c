//! Where the things of an episode lie: let go by clutter style, settled by physics, judged by their
//! true meshes.

use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rapier3d::math::Pose;

use crate::catalogue::ObjectRecord;
use crate::configuration::{ClutterStyle, SceneConfiguration};
use crate::episode::{EpisodeObject, Quaternion};
use crate::placement::check::{Unsound, check};
use crate::placement::layout::{self, Proposal, Thing};
use crate::placement::settle::{Top, Unsettled, settle};
use crate::placement::{Item, Rest, Surface, direction};
use crate::world::{Stage, WorldError};

/// Share of the things meant for a host that must have stayed with it.
const KEPT: f32 = 0.5;

/// Lays the chosen things out, tall ones right after the target so that they come close to it. The
/// inner error says why the layout was thrown away.
///
/// # Errors
/// [`WorldError`] when a model cannot be loaded or has no volume.
pub(super) fn lay(
    stage: &Stage,
    scene: &SceneConfiguration,
    mut records: Vec<&ObjectRecord>,
    rng: &mut ChaCha8Rng,
) -> Result<Result<Vec<EpisodeObject>, &'static str>, WorldError> {
    records[1..].sort_by(|a, b| b.size_m[2].total_cmp(&a.size_m[2]));
    let mut surface = Surface::of(scene);
    // The heap is not always in the middle of the table.
    surface.center += direction(rng) * 0.15 * surface.extent;
    let poses = match with_things(stage, &records, |things| settled(scene.clutter.style, things, &surface, rng))? {
        Ok((_, poses)) => poses,
        Err(reason) => return Ok(Err(reason)),
    };
    let mut ids: Vec<u32> = (1..=records.len() as u32).collect();
    ids.shuffle(rng);
    Ok(Ok(records.iter().zip(&poses).zip(ids).map(|((r, p), id)| object(id, r, p)).collect()))
}

/// Calls `act` with the models and bodies of some objects.
fn with_things<T>(
    stage: &Stage,
    records: &[&ObjectRecord],
    act: impl FnOnce(&[Thing<'_>]) -> T,
) -> Result<T, WorldError> {
    let models = records.iter().map(|r| stage.model(&r.id)).collect::<Result<Vec<_>, _>>()?;
    let solids = records.iter().map(|r| stage.solid(&r.id)).collect::<Result<Vec<_>, _>>()?;
    let rests: Vec<Vec<Rest>> = records
        .iter()
        .map(|r| r.resting.iter().map(|p| Rest { rotation: p.rotation(), probability: p.probability }).collect())
        .collect();
    let things: Vec<Thing<'_>> = (0..records.len())
        .map(|i| Thing {
            category: records[i].category,
            item: Item { model: models[i].as_ref(), rests: &rests[i] },
            solid: solids[i].as_ref(),
        })
        .collect();
    Ok(act(&things))
}

/// What was proposed and the poses in which the things came to rest, or why they are of no use.
pub(crate) fn settled(
    style: ClutterStyle,
    things: &[Thing<'_>],
    surface: &Surface,
    rng: &mut ChaCha8Rng,
) -> Result<(Proposal, Vec<Pose>), &'static str> {
    let proposal = layout::propose(style, things, surface, rng).map_err(|_| "no room on the table")?;
    let top = Top { outline: surface.outline.clone(), height: surface.height };
    let bodies: Vec<_> = things.iter().zip(&proposal.poses).map(|(t, p)| (t.solid, *p)).collect();
    let poses = settle(&top, &bodies).map_err(|e| match e {
        Unsettled::Fell => "something fell off the table",
        Unsettled::Moving => "something does not come to rest",
    })?;
    let bodies: Vec<_> = things.iter().zip(&poses).map(|(t, p)| (t.solid, *p)).collect();
    check(&top, &bodies).map_err(|e| match e {
        Unsound::Penetration => "objects interpenetrate",
        Unsound::Overhang => "something hangs over the table's edge",
    })?;
    let styled =
        matches!(style, ClutterStyle::Sparse | ClutterStyle::Packed) || proposal.holds.iter().any(Option::is_some);
    if !styled || layout::kept(&proposal, things, &poses, surface.height) < KEPT {
        return Err("things do not stay as the clutter style has them");
    }
    Ok((proposal, poses))
}

fn object(instance_id: u32, record: &ObjectRecord, at: &Pose) -> EpisodeObject {
    let q = at.rotation.normalize();
    EpisodeObject {
        instance_id,
        model_id: record.id.clone(),
        category: record.category,
        translation: at.translation.to_array(),
        rotation: Quaternion { w: q.w, x: q.x, y: q.y, z: q.z },
    }
}

#[cfg(test)]
mod tests;
