//! Workers that are killed, and workers that fight for rows; [`disk`] and [`clock`] are the other troubles.

use std::time::Duration;

use super::figures::Figures;
use super::random::Random;
use super::running::check;
use super::site::{Ground, json};
use super::trial::{Quiet, ROWS, Tally, manifest, quiet};
use super::{clock, disk};
use crate::error::Result;
use crate::workspace::{Workspace, say};

/// Runs that are killed.
const KILLS: usize = 100;

/// Pairs of workers that fight.
const FIGHTS: usize = 20;

/// How long a worker has for a manifest.
const LIMIT: Duration = Duration::from_secs(120);

/// Makes trouble of all kinds.
pub(super) fn run(workspace: &Workspace, ground: &Ground, figures: &mut Figures) -> Result<()> {
    workspace.need(&["clocks"])?;
    let quiet = quiet(ground)?;
    figures.add("rows of the manifest", ROWS, "rows");
    figures.add_fine("a quiet run", quiet.took.as_secs_f64(), "s");
    killed(ground, &quiet, figures)?;
    fighting(ground, &quiet, figures)?;
    clock::run(ground, &quiet, figures)?;
    // Last, since it is refused where nothing can be mounted.
    disk::run(ground, &quiet, figures)
}

/// Kills runs at random moments until there were enough. A manifest that is done makes room for a new one.
fn killed(ground: &Ground, quiet: &Quiet, figures: &mut Figures) -> Result<()> {
    say("farm: workers are killed");
    let (mut random, mut tally) = (Random::new(9), Tally::default());
    while tally.troubled < KILLS {
        let site = ground.site(&manifest())?;
        while tally.troubled < KILLS {
            let run = ground.start(&mut site.command("run", &[]))?;
            std::thread::sleep(random.moment(quiet.took / 2));
            if !run.kill()? {
                break;
            }
            tally.troubled += 1;
        }
        tally.settle(&site, quiet, &[])?;
    }
    tally.tell("killed", figures);
    Ok(())
}

/// Lets two workers do one manifest at once. Of every second pair one is killed at a random moment.
fn fighting(ground: &Ground, quiet: &Quiet, figures: &mut Figures) -> Result<()> {
    say("farm: workers fight for rows");
    let (mut random, mut tally) = (Random::new(2), Tally::default());
    let mut killed = 0;
    for fight in 0..FIGHTS {
        let site = ground.site(&manifest())?;
        let one = ground.start(&mut site.command("run", &["--json"]))?;
        let other = ground.start(&mut site.command("run", &["--json"]))?;
        let mut summaries = Vec::new();
        if fight % 2 == 0 {
            summaries.push(one.ended(LIMIT)?);
        } else {
            std::thread::sleep(random.moment(quiet.took / 2));
            killed += usize::from(one.kill()?);
        }
        summaries.push(other.ended(LIMIT)?);
        let mut done = 0;
        let alone = summaries.len() == 1;
        for ended in summaries {
            done += json(&ended.must_be(0, "one of two workers")?.stdout)?["done"].as_u64().unwrap_or(0);
        }
        check(alone || done == ROWS as u64, || format!("two workers say that they did {done} of {ROWS} rows"))?;
        tally.troubled += 2;
        tally.settle(&site, quiet, &[])?;
    }
    tally.tell("two workers", figures);
    figures.add("two workers: one of them killed at work", killed, "runs");
    Ok(())
}
