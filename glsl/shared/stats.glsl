// Statistics of the colour.
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Stats {
    float median;         // luminance of the median lit pixel; 0 where there is none
    float key;
    float exposure;
};

// Bins of a histogram. Luminance: the upper 16 bits of the float. Depth: 9 bits of mantissa, from 2^-34 to 2^30.
const uint BINS = 32768u;
const uint LUMINANCE_SHIFT = 16u;
const uint DEPTH_SHIFT = 14u;
const uint DEPTH_FIRST = (127u - 34u) << 9;
const float NO_LIGHT = -1e31;            // log-luminance of a tile without light
// Of the median: what a pixel may add to its tile, and the least a tile counts for.
const float TILE_CAP = 64.0;
const float TILE_FLOOR = 1.0 / 1024.0;
const float BAD_PIXEL = 1e8;             // times the key
// A pixel of more than so many keys is bad if it is also more than so many times its second-brightest neighbour.
const float ISOLATED_KEYS = 1e3;
const float ISOLATED_RATIO = 100.0;
