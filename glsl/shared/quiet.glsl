// The map of what needs denoising: squares of so many pixels a side, row by row of the padded frame.
const uint MAP_TILE = 16u;
// The noise of a square that has to be denoised whatever the threshold.
const float ALWAYS = 1e30;
