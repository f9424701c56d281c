#![no_main]

// GLB, and glTF that refers to nothing beside it.
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(model) = fuse_render::from_glb(bytes, "model.glb") {
        model.check().expect("what is taken is sound");
    }
});
