// The map of what needs denoising: squares of so many pixels a side, row by row of the padded frame.
const uint MAP_TILE = 16u;
// The noise of a square that has to be denoised whatever the threshold.
const float ALWAYS = 1e30;

// Whether a square, where it is converged, stands for others in what is taken of the whole frame: one in so many, the
// first among them.
bool is_sampled(uvec2 square, uint pitch, uint skew) {
    return (square.x + skew * square.y) % pitch == 0u;
}
