// Joint attention of one 8x8 window and one head, for CPU drivers: an invocation has QUERIES rows of the scores, and
// goes over the keys once, eight at a time: a lane of the subgroup loads one key and hands it to the others. The
// softmax is rescaled as it goes (Milakov and Gimelshein, "Online normalizer calculation for softmax", 2018), so that
// scores are never stored.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/lanes.glsl"
#include "shared/tiles.glsl"
TEXELS_OF(0, x)
TEXELS_OF(1, f)

layout(local_size_x = 64 / QUERIES) in;

layout(push_constant) uniform Push {
    Source x;             // [Q | K | V], head-major
    Source f;             // [Qf | Kf], head-major
    ReadFloats bias;      // 228 values a head
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint x_stride;        // strides and widths in vectors of four
    uint f_stride;
    uint dst_stride;
    uint heads;
    uint key_vectors;     // KEYS
    uint value_vectors;   // VALUES
    float scale;          // 1 / sqrt(d)
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

const uint BIAS_TABLE_STRIDE = 228u;
const float LEAST = -3.40282347e38;    // the least of all finite floats

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;                          // whole groups only
    uint head = gl_WorkGroupID.y;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    uint window_pixel = at.y * width + at.x;

    uint pixels[QUERIES];
    uint bias_at[QUERIES];
    vec4 q[QUERIES * KEYS], qf[QUERIES * KEYS];
    vec4 sums[QUERIES * VALUES];
    float top[QUERIES], total[QUERIES];
    [[unroll]] for (int i = 0; i < QUERIES; ++i) {
        uint query = gl_LocalInvocationID.x + uint(i * 64 / QUERIES);
        pixels[i] = window_pixel + query / 8u * width + query % 8u;
        // Of the key in the window's corner.
        bias_at[i] = head * BIAS_TABLE_STRIDE + (query / 8u + 7u) * 15u + query % 8u + 7u;
        [[unroll]] for (int c = 0; c < KEYS; ++c) {
            q[i * KEYS + c] = LOAD(x, pixels[i] * x_stride + head * KEYS + c) * scale;
            qf[i * KEYS + c] = LOAD(f, pixels[i] * f_stride + head * KEYS + c) * scale;
        }
        [[unroll]] for (int c = 0; c < VALUES; ++c) sums[i * VALUES + c] = vec4(0.0);
        top[i] = LEAST;
        total[i] = 0.0;
    }
    uint k_first = (heads + head) * KEYS;
    uint v_first = 2u * heads * KEYS + head * VALUES;

    for (uint row = 0u; row < 8u; ++row) {
        uint key_pixel = window_pixel + row * width + (gl_SubgroupInvocationID & 7u);
        vec4 k[KEYS], kf[KEYS], v[VALUES];
        [[unroll]] for (int c = 0; c < KEYS; ++c) {
            k[c] = LOAD(x, key_pixel * x_stride + k_first + c);
            kf[c] = LOAD(f, key_pixel * f_stride + k_first + c);
        }
        [[unroll]] for (int c = 0; c < VALUES; ++c) v[c] = LOAD(x, key_pixel * x_stride + v_first + c);

        float scores[QUERIES * 8];
        [[unroll]] for (int key = 0; key < 8; ++key) {
            float sx[QUERIES], sf[QUERIES];
            [[unroll]] for (int i = 0; i < QUERIES; ++i) {
                // Query minus key position.
                sx[i] = sf[i] = bias.v[bias_at[i] - row * 15u - key];
            }
            [[unroll]] for (int c = 0; c < KEYS; ++c) {
                vec4 its_k = FROM_LANE(k[c], uint(key));
                vec4 its_kf = FROM_LANE(kf[c], uint(key));
                [[unroll]] for (int i = 0; i < QUERIES; ++i) {
                    sx[i] += dot(q[i * KEYS + c], its_k);
                    sf[i] += dot(qf[i * KEYS + c], its_kf);
                }
            }
            [[unroll]] for (int i = 0; i < QUERIES; ++i) scores[i * 8 + key] = sx[i] * sf[i];
        }
        [[unroll]] for (int i = 0; i < QUERIES; ++i) {
            float before = top[i];
            [[unroll]] for (int key = 0; key < 8; ++key) top[i] = max(top[i], scores[i * 8 + key]);
            float rescale = exp(before - top[i]);
            total[i] *= rescale;
            [[unroll]] for (int c = 0; c < VALUES; ++c) sums[i * VALUES + c] *= rescale;
            [[unroll]] for (int key = 0; key < 8; ++key) {
                scores[i * 8 + key] = exp(scores[i * 8 + key] - top[i]);
                total[i] += scores[i * 8 + key];
            }
        }
        [[unroll]] for (int key = 0; key < 8; ++key) {
            [[unroll]] for (int c = 0; c < VALUES; ++c) {
                vec4 its_v = FROM_LANE(v[c], uint(key));
                [[unroll]] for (int i = 0; i < QUERIES; ++i) sums[i * VALUES + c] += scores[i * 8 + key] * its_v;
            }
        }
    }
    [[unroll]] for (int i = 0; i < QUERIES; ++i) {
        [[unroll]] for (int c = 0; c < VALUES; ++c) {
            STORE(dst, pixels[i] * dst_stride + head * VALUES + c, sums[i * VALUES + c] * (1.0 / total[i]));
        }
    }
}
