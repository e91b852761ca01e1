//! The colours of plots.

use plotters::style::RGBColor;

/// Colours that most eyes tell apart, on white.
pub const COLORS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(160, 110, 0),
    RGBColor(90, 90, 90),
    RGBColor(110, 60, 160),
];
