// What a dense kernel does with a sum before it is stored.
const uint FLAG_RELU = 2u;
const uint FLAG_LEAKY_RELU = 4u;
const uint FLAG_RESIDUAL = 8u;
const uint FLAG_FILM = 16u;
const uint FLAG_SHUFFLE = 32u;
const uint FLAG_UNSHUFFLE = 64u;

vec4 activate(vec4 x, uint flags) {
    if ((flags & FLAG_RELU) != 0u) return max(x, vec4(0.0));
    if ((flags & FLAG_LEAKY_RELU) != 0u) return max(x, 0.01 * x);
    return x;
}
