//! Every shader is valid WGSL within the portable limits. Needs no device and no GPU stack.

use fuse_render::gpu::shaders::STAGES;
use naga::valid::{Capabilities, ValidationFlags, Validator};

/// WebGPU's default limits.
const WORKGROUP_SIZE: u32 = 256;
const WORKGROUP_BYTES: u32 = 16 << 10;
const STORAGE_BUFFERS: usize = 8;

#[test]
fn all_stages_are_valid_with_the_capabilities_of_every_adapter() {
    for stage in STAGES {
        let source = stage.source();
        let module = naga::front::wgsl::parse_str(&source)
            .unwrap_or_else(|e| panic!("{}.wgsl: {}", stage.name, e.emit_to_string(&source)));
        // No capability beyond core WGSL: no subgroups, no float atomics, no 64-bit integers.
        let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{}.wgsl: {}", stage.name, e.emit_to_string(&source)));

        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).unwrap();
        let names: Vec<&str> = module.entry_points.iter().map(|e| e.name.as_str()).collect();
        assert_eq!(names, stage.entries, "{}.wgsl", stage.name);
        for (i, entry) in module.entry_points.iter().enumerate() {
            let place = format!("{}.wgsl, {}", stage.name, entry.name);
            assert!(entry.workgroup_size.iter().product::<u32>() <= WORKGROUP_SIZE, "{place}");
            let used = |space: fn(naga::AddressSpace) -> bool| {
                let info = info.get_entry_point(i);
                module.global_variables.iter().filter(move |(h, v)| !info[*h].is_empty() && space(v.space))
            };
            let bytes: u32 = used(|s| s == naga::AddressSpace::WorkGroup).map(|(_, v)| layouter[v.ty].size).sum();
            assert!(bytes <= WORKGROUP_BYTES, "{place}: {bytes} bytes of workgroup memory");
            let buffers = used(|s| matches!(s, naga::AddressSpace::Storage { .. })).count();
            assert!(buffers <= STORAGE_BUFFERS, "{place}: {buffers} storage buffers");
            println!("{place}: {bytes} bytes of workgroup memory, {buffers} storage buffers");
        }
    }
}
