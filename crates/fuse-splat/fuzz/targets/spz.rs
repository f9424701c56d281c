#![no_main]

mod attack;
#[path = "../../tests/fuzz/readers.rs"]
#[allow(dead_code)]
mod readers;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| attack::file("map.spz", bytes, readers::spz));
