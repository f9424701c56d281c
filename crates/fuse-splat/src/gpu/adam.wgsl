// Adam; twin of cpu/adam.rs. A thread owns one parameter (y) of one Gaussian (x).

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> gradient: array<f32>;
@group(0) @binding(2) var<storage, read_write> table: array<f32>;
@group(0) @binding(3) var<storage, read_write> first: array<f32>;
@group(0) @binding(4) var<storage, read_write> second: array<f32>;
/// Rate of each parameter over 1 − β₁ᵗ, and 1/(1 − β₂ᵗ).
@group(0) @binding(5) var<storage, read> rates: array<f32>;

@compute @workgroup_size(256)
fn adam(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= frame.gaussians {
        return;
    }
    let at = place(id.x, id.y);
    let g = gradient[at];
    let m = BETA1 * first[at] + (1.0 - BETA1) * g;
    let v = BETA2 * second[at] + (1.0 - BETA2) * g * g;
    first[at] = m;
    second[at] = v;
    table[at] -= rates[id.y] * m / (sqrt(v * rates[PARAMETERS]) + ADAM_EPSILON);
}
