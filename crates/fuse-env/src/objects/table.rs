//! What each split draws from: shape variants per category, finishes per material. Together
//! with [`bands`](super::dice::bands) and [`hues`](super::dice::hues) this is the whole
//! difference between training, development and evaluation objects.

use super::dice::Families;
use crate::catalogue::Category;

/// A material whose finishes differ between the splits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stuff {
    /// Blades, flatware, tool heads.
    Steel,
    /// Handles, mallet heads, rulers.
    Wood,
    /// Glazed vessels.
    Ceramic,
    /// Moulded parts.
    Plastic,
    /// Towels.
    Cloth,
    /// Sponges.
    Foam,
    /// Book covers.
    Cover,
    /// Labels on bottles and markers.
    Label,
}

const fn families(
    train: &'static [&'static str],
    dev: &'static [&'static str],
    eval: &'static [&'static str],
) -> Families {
    Families { train, dev, eval }
}

/// Shape variants of a category.
pub const fn shapes(category: Category) -> Families {
    use Category as C;
    match category {
        C::Knife => families(&["chef", "santoku", "utility"], &["petty"], &["carving", "gyuto"]),
        C::Scissors => families(&["even", "uneven", "narrow"], &["round"], &["tailor", "wide"]),
        C::ButterKnife => families(&["classic", "straight", "hump"], &["spatulate"], &["spreader", "leaf"]),
        C::Spoon => families(&["oval", "egg", "round"], &["pointed"], &["long", "broad"]),
        C::Ladle => families(&["hook", "loop"], &["plain"], &["lipped", "tilted"]),
        C::Mug => families(&["cylinder", "tapered", "barrel"], &["waisted"], &["flared", "footed"]),
        C::Bowl => families(&["round", "conic", "deep"], &["rimmed"], &["straight", "bell"]),
        C::Pitcher => families(&["bellied", "conic", "jug"], &["straight"], &["urn", "enamel"]),
        C::WaterBottle => families(&["sport", "flask", "ribbed"], &["wide"], &["square", "tall"]),
        C::Teapot => families(&["globe", "squat", "pear"], &["conic"], &["cylinder", "angular"]),
        C::Marker => families(&["capped", "posted", "bullet"], &["tapered"], &["jumbo", "square"]),
        C::Ruler => families(&["plain", "beveled", "holed"], &["edged"], &["wide", "grip"]),
        C::Hammer => families(&["curved", "rubber_grip", "straight"], &["steel"], &["framing", "octagonal"]),
        C::Mallet => families(&["block", "drum", "two_faced"], &["barrel"], &["dead_blow", "wedge"]),
        C::Screwdriver => families(&["fluted", "bulb", "cushion"], &["hexagonal"], &["stubby", "slim"]),
        C::Sponge => families(&["slab", "waisted", "rounded"], &["thick"], &["oval", "wavy"]),
        C::Towel => families(&["half", "thirds", "quarter", "rolled"], &["wide"], &["tall", "runner"]),
        C::Book => families(&["hardcover", "paperback", "thick"], &["square"], &["pocket", "tome"]),
        C::BoxCutter => families(&["straight", "curved", "trapeze"], &["dolphin"], &["heavy", "slim"]),
        C::Fork => families(&["dinner", "slim", "table"], &["dessert"], &["three_tined", "serving"]),
        C::Whisk => families(&["balloon", "slim", "french"], &["ball"], &["flat", "wide"]),
        C::Spatula => families(&["slotted", "solid", "tapered"], &["square"], &["fish", "broad"]),
        C::Chopsticks => families(&["round", "square", "faceted"], &["twisted"], &["flat", "long"]),
        C::Tongs => families(&["scalloped", "silicone", "plain"], &["locking"], &["grill", "pasta"]),
        C::MeasuringCup => families(&["jug", "straight", "conic"], &["round"], &["tall", "bell"]),
        C::WineGlass => families(&["bordeaux", "tulip", "white"], &["flute"], &["burgundy", "goblet"]),
        C::Plate => families(&["classic", "coupe", "wide_rim"], &["soup"], &["scalloped", "squarish"]),
        C::Tray => families(&["rectangle", "oval", "deep"], &["square_corners"], &["round", "wide"]),
        C::Colander => families(&["round", "pan", "footed"], &["pot"], &["deep", "cone"]),
        C::Sieve => families(&["round", "deep", "shallow"], &["pan"], &["cone", "pot"]),
        C::Grater => families(&["box", "tower", "footed"], &["square"], &["flat_box", "plain"]),
        C::RollingPin => families(&["classic", "knobbed", "bearing"], &["french"], &["marble", "long"]),
        C::Wrench => families(&["combination", "double", "grip"], &["straight"], &["stubby", "long"]),
        C::Pliers => families(&["combination", "needle", "slip"], &["long_nose"], &["heavy", "bent"]),
        C::TapeMeasure => families(&["rounded", "banded", "plain"], &["square"], &["round", "wide"]),
        C::Pen => families(&["click", "capped", "metal"], &["hexagonal"], &["fountain", "grip"]),
        C::Pencil => families(&["hexagonal", "round", "plain"], &["stub"], &["jumbo", "carpenter"]),
        C::Eraser => families(&["sleeved", "wedge", "two_tone"], &["capsule"], &["barrel", "domino"]),
        C::ScrubBrush => families(&["paddle", "block", "handle"], &["oval"], &["arched", "round_head"]),
        C::Stapler => families(&["classic", "rounded", "long"], &["mini"], &["upright", "heavy"]),
        C::BinderClip => families(&["classic", "narrow", "plain"], &["folded"], &["wide", "tall"]),
        C::TapeDispenser => families(&["swan", "classic", "round"], &["compact"], &["block", "long"]),
        C::Flashlight => families(&["flared", "straight", "tactical"], &["long"], &["lantern", "ringed"]),
        C::Candle => families(&["pillar", "dripping", "chamberstick"], &["square"], &["jar", "spiral"]),
        C::Can => families(&["soup", "ribbed", "plain"], &["flat"], &["large", "tall"]),
        // It has no generator.
        C::Other(_) => families(&[], &[], &[]),
    }
}

/// Finishes of a material.
pub const fn finishes(stuff: Stuff) -> Families {
    match stuff {
        Stuff::Steel => families(&["brushed", "satin", "polished"], &["dull"], &["warm", "hammered"]),
        Stuff::Wood => families(&["oak", "walnut", "beech"], &["cherry"], &["ash", "teak"]),
        Stuff::Ceramic => families(&["plain", "speckled", "bands", "dipped"], &["dots"], &["zigzag", "reactive"]),
        Stuff::Plastic => families(&["plain", "grained"], &["marbled"], &["flecked"]),
        Stuff::Cloth => families(&["border", "stripes", "plain"], &["check"], &["gradient", "pinstripe"]),
        Stuff::Foam => families(&["fine", "coarse"], &["open"], &["mixed"]),
        Stuff::Cover => families(&["title", "banded", "blocks"], &["framed"], &["landscape", "discs"]),
        Stuff::Label => families(&["block", "wave", "bands"], &["diagonal"], &["drops", "chevron"]),
    }
}
