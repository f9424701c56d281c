// Projection: Gaussian → Splat; twin of cpu/project.rs. A thread owns a Gaussian.

@group(0) @binding(2) var<storage, read_write> splats: array<Splat>;

@compute @workgroup_size(256)
fn project(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= frame.gaussians {
        return;
    }
    let g = geometry(i);
    let color = max(colors(i, sh_basis(direction(i).xyz)), vec3(0.0));
    let mean = frame.focal * g.t.xy * g.inverse_z + frame.principal;
    let log2_opacity = -log2(1.0 + exp_clamped(-table[place(i, OPACITY)]));
    // The ellipse α ≥ 1/255 is dᵀ Σ'⁻¹ d ≤ 2 ln(255 o); its box has half sides √(2 ln(255 o) Σ'ᵢᵢ).
    let reach = (log2_opacity - LOG2_ALPHA_MIN) * (2.0 * LN_2);
    let extent = sqrt(max(reach, 0.0) * g.covariance.xz);
    let on_image = all(mean + extent > vec2(0.0)) && all(vec2<f32>(frame.size) > mean - extent);
    let visible = g.valid && reach > 0.0 && on_image;

    let half = 0.5 * (g.covariance.x + g.covariance.z);
    let gap = 0.5 * (g.covariance.x - g.covariance.z);
    let largest = half + sqrt(gap * gap + g.covariance.y * g.covariance.y);

    var splat: Splat;
    splat.mean = mean;
    splat.a = g.conic.x * (-0.5 * LOG2_E);
    splat.b = g.conic.y * -LOG2_E;
    splat.c = g.conic.z * (-0.5 * LOG2_E);
    splat.log2_opacity = log2_opacity;
    splat.red = color.r;
    splat.green = color.g;
    splat.blue = color.b;
    splat.depth = select(0.0, g.t.z, visible);
    splat.extent = extent;
    splat.radius = 3.0 * sqrt(largest);
    splats[i] = splat;
}
