//! COLMAP's `cameras.txt` and `images.txt`: a line for each camera, two for each image, and comments from `#`.

use std::path::Path;
use std::str::FromStr;

use super::models::{ColmapCamera, ColmapImage, MAX_NAME, MODELS};
use crate::base::files::bad_data;
use crate::error::EngineError;

/// Words of an image's line before its name.
const IMAGE_WORDS: usize = 9;

/// Numbers of a point in an image: x, y, number.
const POINT_WORDS: usize = 3;

/// Reads `cameras.txt`: CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS.
pub(super) fn cameras(path: &Path, bytes: &[u8]) -> Result<Vec<ColmapCamera>, EngineError> {
    let mut cameras = Vec::new();
    for (number, text) in lines(path, bytes)?.filter(|(_, text)| is_entry(text)) {
        let line = Line { path, number };
        let mut words = text.split_whitespace();
        let id = line.parse(words.next(), "camera number")?;
        let name = words.next().unwrap_or_default();
        let Some(model) = MODELS.iter().find(|model| model.name == name) else {
            let known: Vec<&str> = MODELS.iter().filter(|m| m.pinhole).map(|m| m.name).collect();
            return Err(line.bad("model", name, &known.join(", ")));
        };
        let width = line.parse(words.next(), "width")?;
        let height = line.parse(words.next(), "height")?;
        let parameters: Vec<f64> =
            words.map(|word| line.finite(Some(word), "parameter")).collect::<Result<_, EngineError>>()?;
        if parameters.len() != model.parameters() {
            let expected = format!("{} for {}", model.parameters(), model.name);
            return Err(line.bad("number of parameters", &parameters.len().to_string(), &expected));
        }
        cameras.push(ColmapCamera { id, model, width, height, parameters });
    }
    Ok(cameras)
}

/// Reads `images.txt`: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, and a line of points, which may be empty.
pub(super) fn images(path: &Path, bytes: &[u8]) -> Result<Vec<ColmapImage>, EngineError> {
    let mut images = Vec::new();
    let mut lines = lines(path, bytes)?;
    while let Some((number, text)) = lines.find(|(_, text)| is_entry(text)) {
        let line = Line { path, number };
        let mut rest = text.trim();
        let mut words = [""; IMAGE_WORDS];
        for word in &mut words {
            let (first, behind) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
            (*word, rest) = (first, behind.trim_start());
        }
        let [id, pose @ .., camera_id] = words;
        let id = line.parse(Some(id), "image number")?;
        let mut numbers = [0.0; 7];
        for (value, word) in numbers.iter_mut().zip(pose) {
            *value = line.finite(Some(word), "pose")?;
        }
        let camera_id = line.parse(Some(camera_id), "camera number")?;
        if rest.is_empty() || rest.len() > MAX_NAME {
            return Err(line.bad("name", &format!("{} bytes", rest.len()), &format!("1 to {MAX_NAME}")));
        }
        let [w, x, y, z, translation @ ..] = numbers;
        images.push(ColmapImage { id, rotation: [w, x, y, z], translation, camera_id, name: rest.to_owned() });
        // Editors strip an empty line at the end.
        if let Some((number, points)) = lines.next() {
            Line { path, number }.check_points(points)?;
        }
    }
    Ok(images)
}

/// The file's lines with their numbers, from 1.
fn lines<'a>(path: &Path, bytes: &'a [u8]) -> Result<impl Iterator<Item = (usize, &'a str)>, EngineError> {
    let text = std::str::from_utf8(bytes).map_err(|error| bad_data(path, "text", error, "UTF-8"))?;
    Ok((1..).zip(text.lines()))
}

fn is_entry(text: &str) -> bool {
    let text = text.trim_start();
    !(text.is_empty() || text.starts_with('#'))
}

struct Line<'a> {
    path: &'a Path,
    number: usize,
}

impl Line<'_> {
    fn bad(&self, field: &str, got: &str, expected: &str) -> EngineError {
        bad_data(self.path, format!("line {}: {field}", self.number), format!("`{got}`"), expected)
    }

    fn parse<T: FromStr>(&self, word: Option<&str>, field: &str) -> Result<T, EngineError> {
        let word = word.unwrap_or_default();
        word.parse().map_err(|_| self.bad(field, word, "a whole number"))
    }

    fn finite(&self, word: Option<&str>, field: &str) -> Result<f64, EngineError> {
        let word = word.unwrap_or_default();
        let value = word.parse().ok().filter(|value: &f64| value.is_finite());
        value.ok_or_else(|| self.bad(field, word, "a finite number"))
    }

    /// Refuses a line that is not one of points, lest every second image of a file without such lines be skipped.
    fn check_points(&self, text: &str) -> Result<(), EngineError> {
        let mut words = text.split_whitespace();
        let last_is_number = words.clone().next_back().is_none_or(|word| word.parse::<i64>().is_ok());
        let (count, got) = (words.by_ref().count(), text.chars().take(40).collect::<String>());
        match last_is_number && count % POINT_WORDS == 0 {
            true => Ok(()),
            false => Err(self.bad("points of an image", &got, "X, Y and POINT3D_ID of each, or an empty line")),
        }
    }
}
