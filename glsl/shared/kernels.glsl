// Predicted kernels: means of taps by exp(logit) times the weight of what is read.

const float LEAST_ALBEDO = 0.05;
const float LEAST_RELIABILITY = 4.248354255291589e-18;   // exp(-40)
const float NO_LOGIT = -1e30;

// Where their weights lie: [biases of what is predicted from, by phase | the reliability's row | biases of the outputs
// | the former's, by phase | the latter's].
const int HIDDEN = 8;                          // vectors of four
const uint ROW_AT = 4u * HIDDEN;
const uint BIASES_AT = ROW_AT + HIDDEN;
const uint RELIABILITY_AT = BIASES_AT + 6u;    // the reliability's bias is the second there
const uint HIDDEN_AT = BIASES_AT + 12u;
// On matrices: after three blocks of 16 rows of halves for each of four phases, of 32 outputs.
const uint MATRIX_OUTPUTS_AT = HIDDEN_AT + 4u * 3u * 64u;

// Outputs: 25 logits, nine of the albedo's kernel from the eighth vector on, five shares and the gate from the eleventh
// on.
const uint ALBEDO_AT = 7u;
const uint SHARES_AT = 10u;
const uint VECTORS = 12u;

// What radiance is divided by: the albedo, where there is any.
vec3 demodulator(vec3 albedo) {
    float has = clamp(max(albedo.x, max(albedo.y, albedo.z)) / LEAST_ALBEDO, 0.0, 1.0);
    return has * max(albedo, vec3(LEAST_ALBEDO)) + (1.0 - has);
}

// exp(-softplus(x)), bounded.
float reliability(float x) {
    return max(1.0 / (1.0 + exp(clamp(x, -60.0, 60.0))), LEAST_RELIABILITY);
}

// A mean in the making: sums of weight times value, and of weight, the weights relative to that of the largest logit so
// far.
struct Average {
    vec4 sum;
    float largest;
};

Average no_average() {
    return Average(vec4(0.0), NO_LOGIT);
}

// What to multiply the sums by before four more taps, and what these count for: nothing where that is 0.
struct Shares {
    vec4 of_taps;
    float of_sums;
    float largest;
};

Shares shares_of(float largest, vec4 logits, vec4 read[4]) {
    vec4 counts = vec4(read[0].w, read[1].w, read[2].w, read[3].w);
    logits = mix(vec4(NO_LOGIT), logits, greaterThan(counts, vec4(0.0)));
    float most = max(largest, max(max(logits.x, logits.y), max(logits.z, logits.w)));
    return Shares(exp(logits - most), exp(largest - most), most);
}

vec4 with_read(vec4 sum, Shares by, vec4 read[4]) {
    sum *= by.of_sums;
    return sum + by.of_taps.x * read[0] + by.of_taps.y * read[1] + by.of_taps.z * read[2] + by.of_taps.w * read[3];
}

// With four more taps, each a value times its weight and the weight.
Average with_taps(Average average, vec4 logits, vec4 read[4]) {
    Shares by = shares_of(average.largest, logits, read);
    return Average(with_read(average.sum, by, read), by.largest);
}

// Where a tap reads, from the middle. Divided by multiplication: CPU drivers divide lane by lane.
ivec2 offset_in_5x5(uint tap) {
    uint row = tap * 13u >> 6;
    return ivec2(tap - 5u * row, row) - 2;
}

ivec2 offset_in_3x3(uint tap) {
    uint row = tap * 11u >> 5;
    return ivec2(tap - 3u * row, row) - 1;
}

const uint FLAG_NO_ALBEDO = 4u;                // the image is of a signal, not divided by the albedo
const uint FLAG_GLOSS = 8u;                    // what it was before it was divided is averaged too

// A share `gate` of what was divided by the albedo, times it, and for the rest what was not.
vec3 with_gloss(vec3 divided, vec3 undivided, vec3 albedo, float gate) {
    return mix(undivided, divided * albedo, gate);
}

// Of a pixel what MixLevels reads: the mean of the image times the first level's share and that, the mean albedo and
// the gate, the other levels' shares. `last` holds the share of the fifth level, which may be impossible, and the gate.
#define STORE_PREDICTED(dst, to, full, undivided, albedo, first, last, flags) { \
    float most = max(max(max((first).x, (first).y), max((first).z, (first).w)), (last).x); \
    vec4 shares = exp((first) - most); \
    float last_share = exp((last).x - most); \
    float inverse = 1.0 / (shares.x + shares.y + shares.z + shares.w + last_share); \
    float gate = 1.0 / (1.0 + exp(clamp(-(last).y, -60.0, 60.0))); \
    vec4 by = vec4(albedo, gate); \
    if (((flags) & FLAG_NO_ALBEDO) != 0u) by = vec4(1.0); \
    vec3 mean = full; \
    if (((flags) & FLAG_GLOSS) != 0u) mean = with_gloss(mean, undivided, by.xyz, by.w); \
    STORE(dst, to, vec4(mean * (shares.x * inverse), shares.x * inverse)); \
    STORE(dst, (to) + 1u, by); \
    STORE(dst, (to) + 2u, vec4(shares.yzw, last_share) * inverse); \
}
