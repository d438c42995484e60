//! Settings at which pictures cost least.

use std::convert::Infallible;

use guard4d_engine::error::EngineError;
use guard4d_engine::render::profile::Viewer;
use guard4d_engine::render::settings::Settings;

const CLEARLY: f64 = 0.95;

/// Those that are found where a picture at some settings costs so much; and how often others were asked.
fn fitted(begun: Settings, mut cost: impl FnMut(Settings) -> f64) -> (Settings, usize) {
    let (own_cost, mut asked) = (cost(begun), 0);
    let mut count = |settings| {
        asked += 1;
        Ok::<_, Infallible>(cost(settings))
    };
    let Ok(found) = begun.fitted(3, CLEARLY, own_cost, &mut count);
    (found, asked)
}

/// Splats of a width of 1 px that are drawn as wide as a film's are not.
fn apart(settings: Settings, dilation: f64) -> f64 {
    let widths = [f64::from(settings.profile().rules.dilation), dilation].map(|dilation| (1.0 + dilation).sqrt());
    (widths[0] - widths[1]).powi(2)
}

#[test]
fn a_profile_has_what_is_set_and_the_rest_of_its_viewer() {
    for viewer in Viewer::ALL {
        assert_eq!(Settings::from(viewer).profile(), viewer.profile(), "{}", viewer.name());
        let set = Settings { dilation: Some(0.7), sh_degree: Some(1), ..viewer.into() }.profile();
        let (mut rules, mut storage) = (viewer.profile().rules, viewer.profile().storage);
        (rules.dilation, storage.sh_degree) = (0.7, 1);
        assert_eq!((set.rules, set.storage), (rules, storage), "{}", viewer.name());
    }
}

#[test]
fn what_is_uploaded_stays_where_only_pixels_differ() {
    let [spark, gsplat, reference] = [Viewer::Spark, Viewer::Gsplat, Viewer::Reference].map(Settings::from);
    assert!(spark.keeps_splats_of(&Settings { dilation: Some(0.1), ..spark }), "another dilation");
    assert!(gsplat.keeps_splats_of(&reference), "splats as the file has them");
    assert!(!spark.keeps_splats_of(&Settings { sh_degree: Some(0), ..spark }), "fewer harmonics");
    assert!(!spark.keeps_splats_of(&gsplat), "another storage");
    // Buckets are made of splats before they are rounded.
    let [play_canvas, super_splat] = [Viewer::PlayCanvas, Viewer::SuperSplat].map(Settings::from);
    assert!(!play_canvas.keeps_splats_of(&super_splat), "another order");
}

#[test]
fn what_a_film_was_widened_by_is_found_and_no_degree_is_left_out_for_it() {
    for viewer in [Viewer::Reference, Viewer::PlayCanvas, Viewer::Antimatter15] {
        // None at all, a film that was made a third smaller, two wider ones and one beyond what is tried.
        for (dilation, about) in [(0.0, 0.01), (0.18, 0.02), (0.45, 0.02), (0.9, 0.03), (4.0, 3.1)] {
            let (found, asked) = fitted(viewer.into(), |settings| apart(settings, dilation) + 1e-4);
            let off = f64::from(found.profile().rules.dilation) - dilation;
            assert!(off.abs() < about, "{dilation} of {}: {found:?}", viewer.name());
            assert_eq!((found.viewer, found.sh_degree), (viewer, None));
            assert!(asked <= 11, "{asked} pictures");
        }
    }
}

#[test]
fn what_is_not_clearly_better_leaves_a_renderers_own_settings() {
    let own = Settings::from(Viewer::Spark);
    let (found, _) = fitted(own, |settings| apart(settings, 0.25) + 1.0);
    assert_eq!(found, own, "by a thousandth");
    let (found, _) = fitted(own, |_| f64::NAN);
    assert_eq!(found, own, "of no numbers");
}

#[test]
fn degrees_that_a_film_shows_are_found_and_those_that_a_viewer_has_not_are_not_tried() {
    let shown =
        |degree: u32| move |settings: Settings| f64::from(settings.profile().storage.sh_degree.abs_diff(degree));
    for degree in 0..3 {
        let (found, _) = fitted(Viewer::Spark.into(), shown(degree));
        assert_eq!((found.sh_degree, found.dilation), (Some(degree), None));
    }
    let own = Settings::from(Viewer::Spark);
    assert_eq!(fitted(own, shown(3)).0, own);
    let none = Settings::from(Viewer::Antimatter15);
    let (found, asked) = fitted(none, shown(0));
    assert_eq!((found, asked), (none, 8), "no degree but none; widths alone");
}

#[test]
fn what_fails_to_be_drawn_is_an_error() {
    let full = || EngineError::Usage { what: "film".to_owned(), got: "none".to_owned(), expected: "one".to_owned() };
    let failed = Settings::from(Viewer::Reference).fitted(3, CLEARLY, 1.0, &mut |_| Err(full()));
    assert_eq!(failed.expect_err("nothing is drawn").to_string(), full().to_string());
}

#[test]
fn they_are_told_in_words() {
    let set = Settings { dilation: Some(0.12), sh_degree: Some(1), ..Viewer::Spark.into() };
    assert_eq!(set.to_string(), "spark, dilation 0.12 px², harmonics to degree 1");
    assert_eq!(Settings::from(Viewer::Gsplat).to_string(), "gsplat");
}
