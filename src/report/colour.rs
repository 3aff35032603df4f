//! Colours of the maps: a diverging scale about zero, and one colour for each class of ties.

/// A colour with transparency: red, green, blue, alpha.
pub(crate) type Rgba = [u8; 4];

/// Ties in the solution.
pub(crate) const USED: Rgba = [0x2b, 0x7b, 0xba, 255];
/// Ties held out of the solution.
pub(crate) const HELD_OUT: Rgba = [0xe8, 0x8a, 0x14, 255];
/// Ties taken out as outliers.
pub(crate) const OUTLIER: Rgba = [0xc2, 0x18, 0x7b, 255];
/// Nothing measured.
pub(crate) const NOTHING: Rgba = [0, 0, 0, 0];

/// From minus to plus: blue, pale, red; told apart with every common kind of colour vision.
const DIVERGING: [[f64; 3]; 7] = [
    [24.0, 70.0, 140.0],
    [58.0, 137.0, 190.0],
    [155.0, 202.0, 225.0],
    [247.0, 247.0, 242.0],
    [248.0, 183.0, 145.0],
    [216.0, 96.0, 77.0],
    [148.0, 18.0, 44.0],
];
/// Steps of the scale on each side of zero: few enough that pictures stay small.
const STEPS: f64 = 24.0;

/// The colour of a value on a scale from `-limit` to `limit`; beyond it the ends of the scale.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within 0 to 255
pub(crate) fn diverging(value: f64, limit: f64) -> Rgba {
    let share = if limit > 0.0 { (value / limit).clamp(-1.0, 1.0) } else { 0.0 };
    let position = ((share * STEPS).round() / STEPS + 1.0) * 3.0;
    let below = (position.floor() as usize).min(5);
    let weight = position - below as f64;
    let mix = |c: usize| (DIVERGING[below][c] * (1.0 - weight) + DIVERGING[below + 1][c] * weight).round() as u8;
    [mix(0), mix(1), mix(2), 255]
}

/// The same scale as a CSS gradient from left to right.
pub(crate) fn diverging_css() -> String {
    let stops: Vec<String> = DIVERGING.iter().map(|c| format!("rgb({} {} {})", c[0], c[1], c[2])).collect();
    format!("linear-gradient(to right,{})", stops.join(","))
}

/// A colour as CSS.
pub(crate) fn css(colour: Rgba) -> String {
    format!("rgb({} {} {})", colour[0], colour[1], colour[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_is_pale_at_zero_and_saturates_at_its_ends() {
        assert_eq!(diverging(0.0, 0.05), [247, 247, 242, 255]);
        assert_eq!(diverging(-0.05, 0.05), diverging(-7.0, 0.05));
        assert_eq!(diverging(0.05, 0.05), [148, 18, 44, 255]);
        assert_eq!(diverging(1.0, 0.0), [247, 247, 242, 255]);
    }
}
