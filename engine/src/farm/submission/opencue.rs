//! A job specification for OpenCue.

use super::task::{Submission, printable};
use crate::error::EngineError;

/// Most frames that Cuebot takes (`MAX_FRAMES` of its `JobSpec`).
const FRAMES: usize = 100_000;
/// Shortest name that Cuebot takes (`NAME_REGEX` there).
const NAME: usize = 3;

/// What OpenCue files a job under. The fields are named as the variables that its own pyoutline reads them from.
#[derive(Clone, Debug)]
pub struct CueNames {
    /// A show that Cuebot knows.
    pub show: String,
    /// A shot of it; Cuebot takes any.
    pub shot: String,
    /// Whose job it is.
    pub user: String,
}

impl CueNames {
    fn check(&self) -> Result<(), EngineError> {
        let wrong = |what: &str, got: &str, expected: &str| EngineError::Usage {
            what: what.to_owned(),
            got: format!("`{got}`"),
            expected: expected.to_owned(),
        };
        for (what, name) in [("SHOW", &self.show), ("SHOT", &self.shot)] {
            if name.len() < NAME || !name.chars().all(|c| c.is_ascii_alphanumeric() || ".-_".contains(c)) {
                return Err(wrong(what, name, "at least three of letters, digits, `.`, `-` and `_`"));
            }
        }
        if self.user.is_empty() || self.user == "root" || self.user.chars().any(char::is_control) {
            return Err(wrong("USER", &self.user, "a user of the farm; OpenCue takes no job of root"));
        }
        Ok(())
    }
}

impl Submission<'_> {
    /// A job specification as pyoutline 1.37 makes it (CJSL 1.15): a layer with a frame for each shard. Facility,
    /// address and number of the user are optional there, and left to the site.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for names or numbers of tasks that Cuebot refuses; [`EngineError::Usage`] for paths that
    /// no shell or no XML can name.
    pub fn opencue(&self, names: &CueNames) -> Result<String, EngineError> {
        names.check()?;
        self.at_most(FRAMES, "the most frames of a job of OpenCue")?;
        for path in [self.program, self.manifest] {
            printable(path)?;
        }
        let [show, shot, user] = [&names.show, &names.shot, &names.user].map(|name| escaped(name));
        let shards = self.shards;
        let command = escaped(&self.command(&format!("--shard #IFRAME#/{shards}"))?);
        Ok(format!(
            r#"<?xml version="1.0"?>
<!DOCTYPE spec PUBLIC "SPI Cue  Specification Language" "http://localhost:8080/spcue/dtd/cjsl-1.15.dtd">
<!-- Exit code 75 asks to go on later. Cuebot counts it as a try, unless its opencue.properties has
     dispatcher.layer_delay.rules=75:1, by which it waits a minute and counts nothing.
     A GPU for each frame: <gpus>1</gpus><gpu_memory>8g</gpu_memory> behind chunk. -->
<spec>
  <show>{show}</show>
  <shot>{shot}</shot>
  <user>{user}</user>
  <job name="guard4d_farm">
    <paused>False</paused>
    <priority>1</priority>
    <maxretries>2</maxretries>
    <autoeat>False</autoeat>
    <env />
    <layers>
      <layer name="shards" type="Render">
        <cmd>{command}</cmd>
        <range>1-{shards}</range>
        <chunk>1</chunk>
        <env />
        <services>
          <service>default</service>
        </services>
        <outputs />
      </layer>
    </layers>
  </job>
  <depends />
</spec>
"#
        ))
    }
}

/// A text between tags.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
