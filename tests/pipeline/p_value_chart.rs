//! The picture of `docs/results/false-claims.md`: how often p-values fall below a rate.

use plotters::backend::SVGBackend;
use plotters::chart::ChartBuilder;
use plotters::coord::combinators::IntoLogRange;
use plotters::drawing::{DrawingAreaErrorKind, IntoDrawingArea};
use plotters::element::PathElement;
use plotters::style::{BLACK, Color, RGBColor, WHITE};

/// Smallest rate that is drawn: that of one reading.
const LEAST: f64 = 1e-5;
/// Points of a line in each power of ten.
const POINTS: i32 = 20;
const GREY: RGBColor = RGBColor(0xcc, 0xcc, 0xcc);
/// Okabe and Ito's blue and orange, which the colour-blind can tell apart.
const COLOURS: [RGBColor; 2] = [RGBColor(0x00, 0x72, 0xb2), RGBColor(0xd5, 0x5e, 0x00)];

/// Lines of two kinds of p-values, and the diagonal of those that are exact.
pub(super) fn svg(series: [(&str, &[f64]); 2]) -> String {
    let mut out = String::new();
    draw(series, &mut out).expect("a string takes any picture");
    out
}

fn draw(series: [(&str, &[f64]); 2], out: &mut String) -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
    let picture = SVGBackend::with_string(out, (560, 400)).into_drawing_area();
    picture.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&picture)
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(58)
        .build_cartesian_2d((LEAST..1.0).log_scale(), (LEAST..1.0).log_scale())?;
    let power = |v: &f64| format!("{v:.0e}");
    chart
        .configure_mesh()
        .disable_mesh()
        .x_desc("rate")
        .y_desc("share of claims with a p-value up to the rate")
        .x_label_formatter(&power)
        .y_label_formatter(&power)
        .draw()?;
    let rates: Vec<f64> = (-5 * POINTS..=0).map(|i| 10.0_f64.powf(f64::from(i) / f64::from(POINTS))).collect();
    let exact: Vec<_> = rates.iter().map(|rate| (*rate, *rate)).collect();
    chart
        .draw_series([PathElement::new(exact, GREY.stroke_width(4))])?
        .label("exact")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], GREY.stroke_width(4)));
    for ((name, p_values), colour) in series.into_iter().zip(COLOURS) {
        let share = |rate: f64| p_values.iter().filter(|p| **p <= rate).count() as f64 / p_values.len() as f64;
        let points = rates.iter().map(|rate| (*rate, share(*rate))).filter(|(_, share)| *share >= LEAST);
        let line = PathElement::new(points.collect::<Vec<_>>(), colour.stroke_width(2));
        chart
            .draw_series([line])?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    chart.configure_series_labels().background_style(WHITE).border_style(BLACK).draw()?;
    picture.present()
}
