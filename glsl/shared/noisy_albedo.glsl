// Where albedo and normals are noisy, and the mean albedo there (docs/neutral.md, "Features"). A workgroup stages its
// tile of 8x8 pixels and three around.
const uint REACH = 3u;
const uint WINDOW = 2u * REACH + 1u;
const uint STAGED = 8u + 2u * REACH;
// The two features, one after the other.
const uint PIXELS = STAGED * STAGED;
const uint RUNS = STAGED * 8u;

// Of the 7 pixels of a row of windows: their mean, and the sum of squared differences from it; of squared differences
// between neighbours: in the row, then from the row to the next one: straight, down right, down left.
struct Run {
    vec4 mean_spread;
    vec4 steps;
};

shared vec3 staged[2u * PIXELS];
shared Run runs[2u * RUNS];

float squared(vec3 x) {
    return dot(x, x);
}

Run run_of(uint first, uint next) {
    vec3 mean = vec3(0.0);
    for (uint i = 0u; i < WINDOW; i++) mean += staged[first + i];
    mean /= float(WINDOW);
    float spread = 0.0;
    vec4 steps = vec4(0.0);
    vec3 left, below_left;
    for (uint i = 0u; i < WINDOW; i++) {
        vec3 here = staged[first + i];
        vec3 below = staged[next + i];
        spread += squared(here - mean);
        steps.y += squared(below - here);
        if (i > 0u) steps += vec4(squared(here - left), 0.0, squared(below - left), squared(below_left - here));
        left = here;
        below_left = below;
    }
    return Run(vec4(mean, spread), steps);
}

// Of a window of a feature, by its first run: the mean; and how noisy it is, from 0 to 1. Noise has no direction:
// neighbours differ in each as much as any two pixels do. Edges, bars and smooth texture have one in which they do not.
vec4 mean_and_noise(uint first, vec2 variances) {
    vec3 mean = vec3(0.0);
    for (uint i = 0u; i < WINDOW; i++) mean += runs[first + 8u * i].mean_spread.xyz;
    mean /= float(WINDOW);
    float spread = 0.0;
    vec4 steps = vec4(0.0);
    for (uint i = 0u; i < WINDOW; i++) {
        Run run = runs[first + 8u * i];
        spread += run.mean_spread.w + float(WINDOW) * squared(run.mean_spread.xyz - mean);
        steps += vec4(run.steps.x, i + 1u < WINDOW ? run.steps.yzw : vec3(0.0));
    }
    const float pairs = float(WINDOW * (WINDOW - 1u));
    steps /= vec4(pairs, pairs, vec2((WINDOW - 1u) * (WINDOW - 1u)));
    float variance = spread / float(WINDOW * WINDOW);
    float least = min(min(steps.x, steps.y), min(steps.z, steps.w));
    // 1 of white noise.
    float ratio = least / max(2.0 * variance, 1e-12);
    float enough = clamp((variance - variances.x) / (variances.y - variances.x), 0.0, 1.0);
    return vec4(mean, enough * clamp((ratio - 0.6) / 0.2, 0.0, 1.0));
}

// The albedo of an invocation's pixel in the tile that begins at `origin`, filtered; for all invocations of a
// workgroup.
vec3 filtered_albedo(uvec2 origin, uvec2 size) {
    for (uint i = gl_LocalInvocationIndex; i < PIXELS; i += 64u) {
        uvec2 offset = uvec2(i % STAGED, i / STAGED);
        uvec2 to = uvec2(abs(ivec2(origin + offset) - int(REACH)));
        uvec2 at = uvec2(reflect_index(to.x, size.x), reflect_index(to.y, size.y));
        staged[i] = unit_albedo(at);
        staged[PIXELS + i] = unit_normal(at);
    }
    barrier();
    for (uint i = gl_LocalInvocationIndex; i < 2u * RUNS; i += 64u) {
        uint feature = i / RUNS * PIXELS;
        uint row = i % RUNS / 8u;
        uint column = i % 8u;
        runs[i] = run_of(
            feature + row * STAGED + column, feature + min(row + 1u, STAGED - 1u) * STAGED + column);
    }
    barrier();
    uint first = gl_LocalInvocationIndex;
    vec3 albedo = staged[(first / 8u + REACH) * STAGED + first % 8u + REACH];
    vec4 of_albedo = mean_and_noise(first, vec2(1e-4, 2e-4));
    // Normals are in [0, 1] here.
    vec4 of_normals = mean_and_noise(RUNS + first, vec2(0.005, 0.015) / 4.0);
    return albedo + (of_albedo.xyz - albedo) * (of_albedo.w * of_normals.w);
}
