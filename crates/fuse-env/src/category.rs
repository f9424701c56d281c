//! The kinds of things: id, label, how they are put down.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::catalogue::CatalogueError;

macro_rules! categories {
    ($($variant:ident $id:literal $label:literal $share:literal,)*) => {
        /// What a thing is. Its id (`butter_knife`) is the label used by segmenters, knowledge
        /// sources and episodes; [`Category::label`] is for people.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Category {
            $(#[doc = concat!("A ", $label, ".")] $variant,)*
            /// One that a user's library adds; see [`Category::named`].
            Other(OwnId),
        }

        impl Category {
            /// Every category that has a generator, in catalogue order.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// Identifier in files and commands.
            pub const fn id(self) -> &'static str {
                match self { $(Self::$variant => $id,)* Self::Other(own) => own.0 }
            }

            /// Name for people; of a user's category its id.
            pub const fn label(self) -> &'static str {
                match self { $(Self::$variant => $label,)* Self::Other(own) => own.0 }
            }

            /// How often people put it down the way it was made to stand or lie; the rest of
            /// the time it rests in any other stable pose. Of a user's category: always.
            pub const fn natural_share(self) -> f32 {
                match self { $(Self::$variant => $share,)* Self::Other(_) => 1.0 }
            }
        }
    };
}

categories! {
    Knife "knife" "kitchen knife" 0.9,
    Scissors "scissors" "scissors" 0.9,
    ButterKnife "butter_knife" "butter knife" 0.8,
    Spoon "spoon" "spoon" 0.9,
    Ladle "ladle" "ladle" 0.8,
    Mug "mug" "mug" 0.88,
    Bowl "bowl" "bowl" 0.93,
    Pitcher "pitcher" "pitcher" 0.95,
    WaterBottle "water_bottle" "water bottle" 0.75,
    Teapot "teapot" "teapot" 1.0,
    Marker "marker" "marker" 0.3,
    Ruler "ruler" "ruler" 1.0,
    Hammer "hammer" "hammer" 0.7,
    Mallet "mallet" "mallet" 0.7,
    Screwdriver "screwdriver" "screwdriver" 0.4,
    Sponge "sponge" "sponge" 0.75,
    Towel "towel" "towel" 1.0,
    Book "book" "book" 0.8,
    BoxCutter "box_cutter" "box cutter" 0.85,
    Fork "fork" "fork" 0.9,
    Whisk "whisk" "whisk" 0.9,
    Spatula "spatula" "spatula" 0.85,
    Chopsticks "chopsticks" "chopsticks" 0.95,
    Tongs "tongs" "tongs" 0.95,
    MeasuringCup "measuring_cup" "measuring cup" 0.93,
    WineGlass "wine_glass" "wine glass" 0.93,
    Plate "plate" "plate" 0.98,
    Tray "tray" "serving tray" 0.98,
    Colander "colander" "colander" 0.92,
    Sieve "sieve" "sieve" 0.7,
    Grater "grater" "box grater" 0.8,
    RollingPin "rolling_pin" "rolling pin" 0.95,
    Wrench "wrench" "wrench" 0.9,
    Pliers "pliers" "pliers" 0.95,
    TapeMeasure "tape_measure" "tape measure" 0.7,
    Pen "pen" "pen" 0.4,
    Pencil "pencil" "pencil" 0.3,
    Eraser "eraser" "eraser" 0.75,
    ScrubBrush "scrub_brush" "scrub brush" 0.6,
    Stapler "stapler" "stapler" 0.85,
    BinderClip "binder_clip" "binder clip" 0.6,
    TapeDispenser "tape_dispenser" "tape dispenser" 0.95,
    Flashlight "flashlight" "flashlight" 0.7,
    Candle "candle" "candle" 0.97,
    Can "can" "food can" 0.85,
}

impl Category {
    /// Whether a user's library added it: it has no generator.
    pub const fn is_own(self) -> bool {
        matches!(self, Self::Other(_))
    }

    /// The category called `id`, or a new one of that name.
    ///
    /// # Errors
    /// [`CatalogueError::CategoryName`] unless the id is of lower-case letters, digits and `_`,
    /// begins with a letter and has at most 48 characters; [`CatalogueError::TooManyCategories`].
    pub fn named(id: &str) -> Result<Self, CatalogueError> {
        match Self::ALL.iter().copied().find(|c| c.id() == id) {
            Some(known) => Ok(known),
            None => OwnId::new(id).map(Self::Other),
        }
    }
}

/// Id of a category that a user's library adds. There is one copy of each in the process, for as
/// long as it runs, so that categories stay as cheap to pass on as those of the shipped set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct OwnId(&'static str);

/// Distinct ids that a process keeps.
const MOST_OWN: usize = 10_000;
/// Longest id.
const LONGEST: usize = 48;

impl OwnId {
    fn new(id: &str) -> Result<Self, CatalogueError> {
        static KNOWN: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
        let sound = id.len() <= LONGEST
            && id.starts_with(|c: char| c.is_ascii_lowercase())
            && id.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_');
        if !sound {
            return Err(CatalogueError::CategoryName(id.chars().take(80).collect()));
        }
        // A poisoned lock still holds whole entries.
        let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = known.get(id) {
            return Ok(Self(kept));
        }
        if known.len() >= MOST_OWN {
            return Err(CatalogueError::TooManyCategories(MOST_OWN));
        }
        let kept: &'static str = Box::leak(id.into());
        known.insert(kept);
        Ok(Self(kept))
    }
}

impl Serialize for Category {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.id())
    }
}

impl<'de> Deserialize<'de> for Category {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let id = std::borrow::Cow::<'de, str>::deserialize(deserializer)?;
        Self::named(&id).map_err(serde::de::Error::custom)
    }
}

impl fmt::Display for Category {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.id())
    }
}

/// One that has a generator; [`Category::named`] takes others too.
impl FromStr for Category {
    type Err = CatalogueError;

    fn from_str(id: &str) -> Result<Self, CatalogueError> {
        Self::ALL
            .iter()
            .copied()
            .find(|c| c.id() == id)
            .ok_or_else(|| CatalogueError::UnknownCategory { found: id.into(), known: ids(Self::ALL) })
    }
}

fn ids(categories: &[Category]) -> String {
    categories.iter().map(|c| c.id()).collect::<Vec<_>>().join(", ")
}
