//! The chart: how near every row comes to its limit.

use std::fmt::Write;

/// Room for the names, for the bars (100 %), and for a figure behind a full bar.
const NAMES: f64 = 470.0;
const SCALE: f64 = 400.0;
const FIGURES: f64 = 60.0;
/// Above the first row: legend and axis.
const TOP: f64 = 54.0;
const ROW: f64 = 22.0;
const BAR: f64 = 7.0;
/// Distance of the grid lines in percent.
const GRID: usize = 20;
/// Okabe and Ito's blue and orange, which the colour-blind can tell apart.
const COLOURS: [&str; 2] = ["#0072b2", "#d55e00"];

/// One row: percent of the limits of the legend, where it has them.
#[derive(Clone, Debug)]
pub(crate) struct Bars {
    pub(crate) name: String,
    pub(crate) shares: [Option<f64>; 2],
}

/// Horizontal bars. A bar ends at 100 %, as data that stays in a cache can pass it; its figure does not.
pub(crate) fn svg(legend: [&str; 2], rows: &[Bars]) -> String {
    let bottom = TOP + ROW * rows.len() as f64;
    let mut body = String::new();
    for (i, (words, colour)) in legend.into_iter().zip(COLOURS).enumerate() {
        let y = 14.0 + 16.0 * i as f64;
        rectangle(&mut body, NAMES, y - 8.0, 12.0, colour);
        text(&mut body, NAMES + 18.0, y, "start", words);
    }
    for percent in (0..=100).step_by(GRID) {
        let x = NAMES + SCALE * percent as f64 / 100.0;
        writeln!(body, "<path d=\"M{x} {TOP}V{bottom}\" stroke=\"#ddd\"/>").expect("a string takes any text");
        text(&mut body, x, TOP - 6.0, "middle", &format!("{percent} %"));
    }
    for (i, row) in rows.iter().enumerate() {
        let top = TOP + ROW * i as f64;
        text(&mut body, NAMES - 8.0, top + 14.0, "end", &row.name);
        for (k, (share, colour)) in row.shares.into_iter().zip(COLOURS).enumerate() {
            let Some(share) = share.filter(|s| s.is_finite()) else { continue };
            let width = SCALE * share.clamp(0.0, 100.0) / 100.0;
            let y = top + 3.0 + (BAR + 1.0) * k as f64;
            rectangle(&mut body, NAMES, y, width, colour);
            let figure = format!("{share:.0} %");
            writeln!(
                body,
                "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"8\">{figure}</text>",
                NAMES + width + 4.0,
                y + BAR
            )
            .expect("a string takes any text");
        }
    }
    drawing(NAMES + SCALE + FIGURES, bottom + 10.0, &body)
}

fn rectangle(out: &mut String, x: f64, y: f64, width: f64, colour: &str) {
    writeln!(out, "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{BAR}\" fill=\"{colour}\"/>")
        .expect("a string takes any text");
}

/// A picture of `width` and `height` on white that needs no other file.
fn drawing(width: f64, height: f64, body: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n{body}</svg>\n"
    )
}

/// Words whose `anchor` (start, middle or end) is at a point.
fn text(out: &mut String, x: f64, y: f64, anchor: &str, words: &str) {
    let words = words.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    writeln!(out, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{words}</text>").expect("a string");
}
