//! Which things an episode is made of: a target for the verb, near misses, tall things that may hide
//! it, and others.

use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;

use super::Validity;
use crate::catalogue::{Category, ObjectRecord};
use crate::configuration::SceneConfiguration;
use crate::world::Stage;

/// Chance of a further valid object among the distractors, for each of two.
const SECOND_TARGET: f64 = 0.3;

/// Looks and handling: things of one family are near misses of each other.
fn family(category: Category) -> u8 {
    use Category as C;
    match category {
        C::Mug | C::Bowl | C::Pitcher | C::WaterBottle | C::Teapot => 0,
        C::Sponge | C::Towel | C::Book => 1,
        _ => 2,
    }
}

/// A target and its distractors, the target first; all of recognised categories.
pub(super) fn choose<'a>(
    stage: &'a Stage,
    scene: &SceneConfiguration,
    validity: &Validity,
    verb: &str,
    strict: bool,
    rng: &mut ChaCha8Rng,
) -> Option<Vec<&'a ObjectRecord>> {
    let valid = validity.get(verb)?;
    let mut all: Vec<&ObjectRecord> =
        stage.catalogue().of(scene.split).filter(|r| r.category.is_recognised()).collect();
    let mut categories: Vec<Category> = all.iter().map(|r| r.category).filter(|c| valid.contains(c)).collect();
    categories.dedup();
    let category = *categories.choose(rng)?;
    let mine: Vec<&ObjectRecord> = all.iter().copied().filter(|r| r.category == category).collect();
    let target = *mine.choose(rng)?;
    all.retain(|r| r.id != target.id);
    all.shuffle(rng);
    let [low, high] = scene.clutter.distractors;
    let wanted = rng.random_range(low..=high) as usize;
    let mut chosen = vec![target];
    let mut seconds = (0..2).filter(|_| rng.random_bool(SECOND_TARGET) || !strict).count();
    let near = |r: &ObjectRecord| !valid.contains(&r.category) && family(r.category) == family(category);
    let tall = |r: &ObjectRecord| !valid.contains(&r.category) && family(r.category) == 0;
    for (rule, count) in [(&near as &dyn Fn(&ObjectRecord) -> bool, 3), (&tall, 3), (&|_: &ObjectRecord| true, wanted)]
    {
        let mut left = count.min((wanted + 1).saturating_sub(chosen.len()));
        all.retain(|r| {
            let second = valid.contains(&r.category);
            if left == 0 || !rule(r) || (second && seconds == 0) {
                return true;
            }
            left -= 1;
            seconds -= usize::from(second);
            chosen.push(*r);
            false
        });
    }
    Some(chosen)
}
