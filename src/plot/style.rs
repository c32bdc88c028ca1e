//! Colours of the pictures, distinguishable in greyscale and with colour blindness (accents from Okabe & Ito 2008,
//! viridis for the speed).

/// Text and strong lines.
pub(super) const INK: &str = "#1f2933";
/// Secondary text.
pub(super) const FAINT_INK: &str = "#616e7c";
/// Page.
pub(super) const PAPER: &str = "#ffffff";
/// Ground beside the road.
pub(super) const GROUND: &str = "#eef1ea";
/// Road surface.
pub(super) const ROAD: &str = "#d5dae0";
/// Lanelets that are not for cars.
pub(super) const NON_DRIVABLE: &str = "#e4e2da";
/// Outer bounds of the road.
pub(super) const BOUND: &str = "#7b8794";
/// Bounds between lanes.
pub(super) const LANE_MARK: &str = "#ffffff";
/// Centre lines.
pub(super) const CENTRE: &str = "#b8c0c9";
/// Stop lines.
pub(super) const STOP_LINE: &str = "#c81e1e";
/// Goal region.
pub(super) const GOAL: &str = "#009e73";
/// Static obstacles.
pub(super) const STATIC: &str = "#52606d";
/// Moving vehicles.
pub(super) const MOVING: &str = "#d55e00";
/// Pedestrians and bicycles.
pub(super) const VULNERABLE: &str = "#b0307f";
/// The driven path and driven values.
pub(super) const DRIVEN: &str = "#0b3d91";
/// Reference values.
pub(super) const REFERENCE: &str = "#e69f00";
/// Committed plans and their fallback stops.
pub(super) const PLAN: &str = "#56a0d3";
/// Candidates.
pub(super) const CANDIDATE: &str = "#9aa5b1";
/// Background of panels.
pub(super) const PANEL: &str = "#f8f9fb";
/// Grid lines.
pub(super) const GRID: &str = "#e4e7eb";
/// The line at zero.
pub(super) const ZERO: &str = "#9aa5b1";
/// Comfort limits.
pub(super) const LIMIT: &str = "#a06000";
/// Fallback limits, speed limits, failed checks.
pub(super) const ALARM: &str = "#c81e1e";
/// Passed checks.
pub(super) const PASS: &str = "#00795a";

/// Viridis at 0, 1/8, … 7/8: without the top yellow, which has too little contrast on a light road.
const VIRIDIS: [[f64; 3]; 8] = [
    [68.0, 1.0, 84.0],
    [71.0, 44.0, 122.0],
    [59.0, 81.0, 139.0],
    [44.0, 113.0, 142.0],
    [33.0, 144.0, 141.0],
    [39.0, 173.0, 129.0],
    [92.0, 200.0, 99.0],
    [170.0, 220.0, 50.0],
];

/// Lower end of the colour scale.
pub(super) const VIRIDIS_LOW: &str = "#440154";
/// Upper end of the colour scale.
pub(super) const VIRIDIS_HIGH: &str = "#aadc32";

/// Colour of a value in 0…1 (clamped), as red, green, blue.
pub(crate) fn viridis(ratio: f64) -> [u8; 3] {
    let place = if ratio.is_finite() { ratio.clamp(0.0, 1.0) } else { 0.0 } * (VIRIDIS.len() - 1) as f64;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within the table
    let below = (place.floor() as usize).min(VIRIDIS.len() - 2);
    let part = place - below as f64;
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // 0…255
    [0, 1, 2].map(|i| (VIRIDIS[below][i] + part * (VIRIDIS[below + 1][i] - VIRIDIS[below][i])).round() as u8)
}

/// A colour as `#rrggbb`.
pub(super) fn hex([r, g, b]: [u8; 3]) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}
