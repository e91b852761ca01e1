// One group of 64 fills one tile of the padded frame; the padding mirrors the frame, again and again where it is
// smaller than the padding, without repeating the edge.
uint reflect_index(uint i, uint n) {
    if (n == 1u) return 0u;
    uint period = 2u * (n - 1u);
    uint m = i % period;
    return m < n ? m : period - m;
}
