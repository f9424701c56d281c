//! Making episodes: a target for a verb, distractors with near misses, a layout, and a start from
//! which the target is partly hidden although some viewpoint shows it well.

mod choose;
mod lay;
mod requests;

use std::collections::BTreeMap;

use fuse_render::Renderer;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::catalogue::{Category, Split};
use crate::configuration::SceneConfiguration;
use crate::difficulty::{Difficulty, KnobError};
use crate::episode::{EPISODE_SCHEMA_VERSION, Episode, EpisodeObject, GOOD_PX};
use crate::ring::{Ring, Viewpoint};
use crate::targets::{self, Subject, TargetStatistics, good_view, statistics};
use crate::world::{Stage, WorldError};

pub use choose::KIN;
pub(crate) use lay::settled;
pub use requests::{Request, requests};

/// Layouts that are tried for one episode; more would only make a hopeless request fail later.
const ATTEMPTS: u64 = 60;
/// Layouts after which another valid thing may stand in full view at the start, and two of them are
/// laid: where all tall things are valid (for pouring), only they can hide one another.
const STRICT_ATTEMPTS: u64 = 24;
/// Further seeds that a set tries where one has no episode.
const FURTHER_SEEDS: u64 = 8;
/// Rows and columns of which one is looked at to see soon that a layout will not do.
const COARSE: u32 = 4;
/// By how much shares and pixels that are counted so may differ from the exact ones.
const SLACK: f32 = 0.08;

/// Reasons for throwing a layout away.
const NOT_HIDDEN: &str = "no view that hides the target enough";
const TOO_SMALL: &str = "the target is too small in every view";
const NEVER_WELL: &str = "the target is never seen well";
const NO_EPISODE: &str = "no episode for a seed: another was drawn";

/// Categories valid for each verb.
pub type Validity = BTreeMap<String, Vec<Category>>;

/// Why layouts were thrown away, and how often.
pub type Rejections = BTreeMap<&'static str, u32>;

/// Why no episode was made.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// The verb has no row in the validity table.
    #[error("unknown verb `{found}`; known verbs: {}", known.join(", "))]
    Verb {
        /// Verb asked for.
        found: String,
        /// Verbs that exist.
        known: Vec<String>,
    },
    /// No object of the split can serve the verb.
    #[error("no object of split {split} is valid for `{verb}`")]
    NoTarget {
        /// Verb.
        verb: String,
        /// Split.
        split: Split,
    },
    /// Every layout was thrown away.
    #[error(
        "no episode for `{verb}` in scene `{scene}` with seed {seed}: {ATTEMPTS} layouts were thrown away ({}); \
         another seed or scene may have one",
        reasons(rejections)
    )]
    Exhausted {
        /// Verb.
        verb: String,
        /// Scene.
        scene: String,
        /// Seed.
        seed: u64,
        /// Reasons and counts.
        rejections: Rejections,
    },
    /// A knob out of its range.
    #[error(transparent)]
    Difficulty(#[from] KnobError),
    /// Objects, scenes or renderer.
    #[error(transparent)]
    World(#[from] WorldError),
}

impl From<crate::configuration::ConfigurationError> for GenerateError {
    fn from(error: crate::configuration::ConfigurationError) -> Self {
        Self::World(error.into())
    }
}

/// Reasons with how often each, the most frequent first.
fn reasons(rejections: &Rejections) -> String {
    let mut counted: Vec<_> = rejections.iter().collect();
    counted.sort_by_key(|(reason, times)| (std::cmp::Reverse(**times), **reason));
    counted.iter().map(|(reason, times)| format!("{reason}: {times}")).collect::<Vec<_>>().join(", ")
}

/// A finished episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Made {
    /// It.
    pub episode: Episode,
    /// What the viewpoints see of its valid targets, in their order.
    pub statistics: Vec<TargetStatistics>,
    /// Why layouts before it were thrown away.
    pub rejections: Rejections,
}

/// Viewpoints from which the target is partly hidden; if `strict`, only those where no other valid
/// thing stands in full view.
fn starts(targets: &[TargetStatistics], strict: bool, difficulty: &Difficulty) -> Vec<Viewpoint> {
    let Some((target, others)) = targets.split_first() else { return vec![] };
    let [low, high] = difficulty.start_fraction;
    let hidden = |v: &Viewpoint| {
        let in_view = |o: &TargetStatistics| o.fraction(*v) > high && o.visible_px[v.index()] >= GOOD_PX;
        (low..=high).contains(&target.fraction(*v))
            && target.unoccluded_px[v.index()] >= difficulty.start_unoccluded_px
            && good_view(target, *v).is_some_and(|good| good.moves >= difficulty.least_moves)
            && !(strict && others.iter().any(in_view))
    };
    Viewpoint::all().filter(hidden).collect()
}

/// Looks at the target from every second node, coarsely, to see soon that a layout will not do: first alone, which is
/// cheap, then in the whole scene from where it is large enough.
fn screen(whole: &Renderer, ring: &Ring, target: &Subject, difficulty: &Difficulty) -> Option<&'static str> {
    let views: Vec<Viewpoint> = Viewpoint::all().filter(|v| v.node() % 2 == 0).collect();
    let alone = targets::count(&target.alone, ring, &views, &[target.id], COARSE);
    let enough = |px: u32, least: u32| px as f32 >= least as f32 * (1.0 - 4.0 * SLACK);
    let least = difficulty.start_unoccluded_px.min(difficulty.good_px);
    let large: Vec<(Viewpoint, u32)> =
        views.into_iter().zip(alone.iter().map(|c| c[0])).filter(|(_, px)| enough(*px, least)).collect();
    if !large.iter().any(|(_, px)| enough(*px, difficulty.good_px)) {
        return Some(TOO_SMALL);
    }
    let views: Vec<Viewpoint> = large.iter().map(|(v, _)| *v).collect();
    let seen = targets::count(whole, ring, &views, &[target.id], COARSE);
    let (mut hidden, mut well) = (false, false);
    for ((_, alone), seen) in large.iter().zip(&seen) {
        let fraction = seen[0] as f32 / (*alone).max(1) as f32;
        let [low, high] = difficulty.start_fraction;
        hidden |= (low - SLACK..=high + SLACK).contains(&fraction) && enough(*alone, difficulty.start_unoccluded_px);
        well |= fraction >= difficulty.good_fraction - SLACK && enough(seen[0], difficulty.good_px);
    }
    if !hidden {
        return Some(NOT_HIDDEN);
    }
    (!well).then_some(NEVER_WELL)
}

/// Makes the episode of a request, and counts why layouts before it were thrown away. The same
/// request and difficulty give the same episode.
pub fn episode(
    stage: &Stage,
    validity: &Validity,
    request: &Request,
    difficulty: &Difficulty,
) -> Result<Made, GenerateError> {
    difficulty.check()?;
    let scene = stage.scene(&request.scene)?;
    if !validity.contains_key(&request.verb) {
        let known = validity.keys().cloned().collect();
        return Err(GenerateError::Verb { found: request.verb.clone(), known });
    }
    let mut rejections = Rejections::new();
    for attempt in 0..ATTEMPTS {
        match layout(stage, scene, validity, request, difficulty, attempt)? {
            Ok((episode, statistics)) => return Ok(Made { episode, statistics, rejections }),
            Err(reason) => *rejections.entry(reason).or_insert(0) += 1,
        }
    }
    Err(GenerateError::Exhausted {
        verb: request.verb.clone(),
        scene: request.scene.clone(),
        seed: request.seed,
        rejections,
    })
}

/// One layout: the episode on it, or why it is thrown away.
fn layout(
    stage: &Stage,
    scene: &SceneConfiguration,
    validity: &Validity,
    request: &Request,
    difficulty: &Difficulty,
    attempt: u64,
) -> Result<Result<(Episode, Vec<TargetStatistics>), &'static str>, GenerateError> {
    let mut rng = ChaCha8Rng::seed_from_u64(request.seed);
    rng.set_stream(attempt);
    let strict = attempt < STRICT_ATTEMPTS;
    let records = choose::choose(stage, scene, validity, &request.verb, difficulty, strict, &mut rng)
        .ok_or_else(|| GenerateError::NoTarget { verb: request.verb.clone(), split: scene.split })?;
    let objects = match lay::lay(stage, scene, records, &mut rng)? {
        Ok(objects) => objects,
        Err(reason) => return Ok(Err(reason)),
    };
    let valid = validity.get(&request.verb).map_or(&[][..], Vec::as_slice);
    let asked: Vec<&EpisodeObject> = objects.iter().filter(|o| valid.contains(&o.category)).collect();
    let subjects = stage.subjects(scene, &asked)?;
    // In the episode's order: of surfaces at the same depth the first drawn is seen.
    let mut drawn = objects.clone();
    drawn.sort_by_key(|o| o.instance_id);
    let (whole, ring) = (stage.renderer(scene, &drawn, false)?, Ring::of(scene));
    if let Some(reason) = subjects.first().and_then(|target| screen(&whole, &ring, target, difficulty)) {
        return Ok(Err(reason));
    }
    let statistics = statistics(&whole, &ring, &subjects);
    let well = |v| statistics[0].well_seen(v, difficulty.good_px, difficulty.good_fraction);
    if !Viewpoint::all().any(well) {
        return Ok(Err(NEVER_WELL));
    }
    let starts = starts(&statistics, strict, difficulty);
    // A share is drawn first, because views that hide little are far more frequent than those that hide much.
    let wanted = rng.random_range(difficulty.start_fraction[0]..difficulty.start_fraction[1]);
    let off = |v: &Viewpoint| (statistics[0].fraction(*v) - wanted).abs();
    let Some(start) = starts.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))) else { return Ok(Err(NOT_HIDDEN)) };
    Ok(assemble(request, scene, objects, &statistics, start).map(|episode| (episode, statistics)).ok_or(NEVER_WELL))
}

fn assemble(
    request: &Request,
    scene: &SceneConfiguration,
    mut objects: Vec<EpisodeObject>,
    statistics: &[TargetStatistics],
    start: Viewpoint,
) -> Option<Episode> {
    let target = objects.first()?.instance_id;
    let good = good_view(statistics.first()?, start)?;
    let valid_target_ids: Vec<u32> = statistics.iter().map(|s| s.instance_id).collect();
    let distractor_ids = objects[1..].iter().map(|o| o.instance_id).collect();
    let mut labels: Vec<String> = vec![];
    for o in objects.iter().filter(|o| valid_target_ids.contains(&o.instance_id)) {
        if !labels.iter().any(|l| l == o.category.id()) {
            labels.push(o.category.id().to_owned());
        }
    }
    objects.sort_by_key(|o| o.instance_id);
    Some(Episode {
        schema_version: EPISODE_SCHEMA_VERSION,
        episode_id: request.episode_id.clone(),
        scene_id: scene.name.clone(),
        split: scene.split,
        seed: request.seed,
        query: request.query.clone(),
        verb: request.verb.clone(),
        target,
        objects,
        valid_target_ids,
        distractor_ids,
        candidate_sets: BTreeMap::from([("oracle".to_owned(), labels)]),
        start_node: start.node(),
        start_pitch: start.pitch(),
        start_px: statistics[0].visible_px[start.index()],
        start_fraction: statistics[0].fraction(start),
        best_node: good.best.node(),
        best_pitch: good.best.pitch(),
        best_px: statistics[0].visible_px[good.best.index()],
        best_fraction: statistics[0].fraction(good.best),
        moves_to_good_view: good.moves,
    })
}

/// Makes all requested episodes, in their order, in parallel; the result does not depend on threads.
/// Where a seed has no episode, the next is drawn from it.
pub fn episodes(
    stage: &Stage,
    validity: &Validity,
    requests: &[Request],
    difficulty: &Difficulty,
) -> Result<Vec<Made>, GenerateError> {
    requests.par_iter().map(|r| persistent(stage, validity, r, difficulty)).collect()
}

fn persistent(
    stage: &Stage,
    validity: &Validity,
    request: &Request,
    difficulty: &Difficulty,
) -> Result<Made, GenerateError> {
    let (mut request, mut before) = (request.clone(), Rejections::new());
    let mut left = FURTHER_SEEDS;
    loop {
        match episode(stage, validity, &request, difficulty) {
            Ok(mut made) => {
                add(&mut made.rejections, &before);
                return Ok(made);
            }
            Err(GenerateError::Exhausted { rejections, .. }) if left > 0 => {
                left -= 1;
                add(&mut before, &rejections);
                *before.entry(NO_EPISODE).or_insert(0) += 1;
                request.seed = ChaCha8Rng::seed_from_u64(request.seed).random::<u64>() >> 11;
            }
            Err(error) => return Err(error),
        }
    }
}

fn add(total: &mut Rejections, more: &Rejections) {
    for (reason, times) in more {
        *total.entry(reason).or_insert(0) += times;
    }
}

#[cfg(test)]
mod tests;
