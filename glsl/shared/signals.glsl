// What kind of signal it is.
const uint FLAG_SIGNAL_ONE = 1u << 12;     // one channel, else three
const uint FLAG_LIGHT = 1u << 13;          // a part of the colour
const uint FLAG_ALPHA = 1u << 14;          // from 0 to 1
