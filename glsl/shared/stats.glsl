// Statistics of the colour.
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Stats {
    float median;         // luminance of the median lit pixel; 0 where there is none
    float key;
    float exposure;
    float noise;          // share of the lit pixels that are noisy; 1 where none is lit
    float largest[3];     // sample of each channel
};

// Bins of a histogram. Luminance: the upper 16 bits of the float. Depth: 9 bits of mantissa, from 2^-34 to 2^30.
const uint BINS = 32768u;
const uint LUMINANCE_SHIFT = 16u;
const uint DEPTH_SHIFT = 14u;
const uint DEPTH_FIRST = (127u - 34u) << 9;
// Of the median: what a pixel may add to its tile, and the least a tile counts for.
const float TILE_CAP = 64.0;
const float TILE_FLOOR = 1.0 / 1024.0;

// What is known of a tile: the bits of its mean colour, then its lit pixels | its noisy ones << 16.
const uint TILE_WORDS = 4u;
// A channel without a good sample: no number.
const uint NO_SAMPLE = 0xffffffffu;
// What is known of so many tiles together, in floats: the sum of the logarithms of luminance and the tiles that have
// one, noisy pixels, lit ones, the largest sample of each channel, and the tiles that lack a channel's mean.
const uint RUN_TILES = 8u;
const uint RUN_FLOATS = 8u;
