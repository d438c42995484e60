//! What was read: films, and some of their frames beside the original.

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use guard4d_engine::detect::exhibit::{Exhibit, Nearest, difference};
use guard4d_engine::detect::report::{ClipReading, VerifyReport};
use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::media::framing::Rect;
use guard4d_engine::media::png::png_bytes;
use maud::{Markup, html};

use super::text::{file_name, plain};

/// Longest side of a picture in the page, px.
const SIDE_PX: u32 = 640;
/// How much larger differences are shown than they are.
const TIMES: u8 = 20;

pub(super) fn section(report: &VerifyReport, clean: &[Vec<Frame>]) -> Result<Markup, EngineError> {
    let shown = report.exhibits.iter().enumerate().map(|(at, exhibit)| figure(at, exhibit, clean));
    let shown = shown.collect::<Result<Vec<_>, _>>()?;
    Ok(html! {
        h2 { "What was read" }
        p { (report.frames) " frames. All films are read as one." }
        @for clip in &report.clips { (film(clip, report.evidence.num_bits)) }
        @if !report.damage.is_empty() {
            h3 { "Damage" }
            ul { @for line in &report.damage { li { (plain(line)) } } }
        }
        h2 { "Frames" }
        @if clean.is_empty() {
            p.soft { "The original was not given, so that frames stand alone." }
        } @else {
            p.soft {
                "Beside each frame is the view of the original that it looks most like. Nobody has told the program "
                "where the film was taken from."
            }
        }
        @for figure in shown { (figure) }
    })
}

fn film(clip: &ClipReading, num_bits: u32) -> Markup {
    let (width, height) = clip.size_px;
    html! {
        h3 { bdi { (file_name(&clip.name)) } }
        dl {
            dt { "bits" }
            dd { (clip.matches) " of " (num_bits) " agree in this film alone" }
            @if let Some(id) = clip.id { dt { "number read" } dd { (id) } }
            dt { "frames" }
            dd { (clip.frames) " of " (width) " × " (height) " px" }
            @if let Some(Rect { x, y, width, height }) = clip.cut {
                dt { "cut to" }
                dd { (width) " × " (height) " px at (" (x) ", " (y) ")" }
            }
            @if let Some(hash) = clip.blake3 { dt { "BLAKE3" } dd { code { (hash) } } }
        }
    }
}

fn figure(at: usize, exhibit: &Exhibit, clean: &[Vec<Frame>]) -> Result<Markup, EngineError> {
    let name = format!("Frame {} of {}", exhibit.frame, file_name(&exhibit.clip));
    let film = picture(&exhibit.picture)?;
    let Some(nearest) = exhibit.nearest(clean)? else {
        return Ok(html! {
            figure.alone {
                img src=(film) alt=(name);
                figcaption { bdi { (name) } }
            }
        });
    };
    let Nearest { view, frame, picture: original, psnr } = &nearest;
    let of_original = format!("frame {frame} of view {view} of the original");
    if !nearest.is_same_view() {
        return Ok(html! {
            figure {
                div.pair {
                    div { img src=(film) alt=(name); span { "film" } }
                    div { img src=(picture(original)?) alt=(of_original); span { "nearest view of the original" } }
                }
                figcaption {
                    bdi { (name) } ". " (of_original) " is nearest, at " (format!("{:.1}", psnr.0))
                    " dB: another camera, so that a difference would show nothing."
                }
            }
        });
    }
    let identical = psnr.0.is_infinite();
    let caption = html! {
        bdi { (name) } "; " (of_original) ": "
        @if identical { "identical." } @else { (format!("{:.1}", psnr.0)) " dB apart." }
    };
    compared(&Compared { at, film: &exhibit.picture, original, name: &name, of_original: &of_original }, &caption)
}

/// A frame and the same view of the original.
pub(super) struct Compared<'a> {
    /// Number of the figure in the page.
    pub(super) at: usize,
    pub(super) film: &'a Frame,
    pub(super) original: &'a Frame,
    /// Of the frame.
    pub(super) name: &'a str,
    pub(super) of_original: &'a str,
}

/// Both over each other, with a slider, and their difference.
pub(super) fn compared(shown: &Compared<'_>, caption: &Markup) -> Result<Markup, EngineError> {
    let Compared { at, film, original, name, of_original } = shown;
    let differs = picture(&difference(film, original, TIMES)?)?;
    let slider = format!("compare-{at}");
    Ok(html! {
        figure data-compare {
            div.looks {
                div {
                    div.pair {
                        div { img src=(picture(film)?) alt=(name); span { "film" } }
                        div.original { img src=(picture(original)?) alt=(of_original); span { "original" } }
                    }
                    div.slide {
                        label for=(slider) { "film to original" }
                        input id=(slider) type="range" min="0" max="100" value="50";
                    }
                }
                div.alone {
                    img src=(differs) alt=(format!("Difference of both, {TIMES} times as large"));
                    span { "the difference, " (TIMES) " times as large" }
                }
            }
            figcaption { (caption) }
        }
    })
}

/// A picture as the page holds it, made smaller if it is large.
fn picture(frame: &Frame) -> Result<String, EngineError> {
    let longest = frame.width().max(frame.height());
    let small =
        |side: u32| u32::try_from(u64::from(side) * u64::from(SIDE_PX) / u64::from(longest)).unwrap_or(1).max(1);
    let bytes = match longest > SIDE_PX {
        true => png_bytes(&frame.resized((small(frame.width()), small(frame.height())))?),
        false => png_bytes(frame),
    };
    Ok(format!("data:image/png;base64,{}", BASE64_STANDARD.encode(bytes)))
}
