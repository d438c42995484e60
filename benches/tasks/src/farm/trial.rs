//! A manifest of short rows that is done under trouble, and what must be true of it in the end.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::figures::Figures;
use super::running::check;
use super::site::{Ground, MODELS, Site, count, repeated};
use crate::error::Result;

/// Rows of the manifest.
pub(super) const ROWS: usize = 40;

/// Rows at its end that read what rows before them make.
const DEPENDENT: usize = 4;

/// What a run without trouble makes, and how long it takes.
pub(super) struct Quiet {
    pub(super) made: BTreeMap<String, Vec<u8>>,
    pub(super) took: Duration,
}

/// What one kind of trouble came to.
#[derive(Default)]
pub(super) struct Tally {
    /// Manifests that were brought to their end.
    farms: usize,
    /// Runs that were in trouble.
    pub(super) troubled: usize,
    /// Rows that were begun more than once.
    begun_again: usize,
    /// Rows that were recorded as done more than once.
    done_twice: usize,
    /// Attempts that were recorded as failed.
    failed: usize,
}

/// Files of every kind that `convert` writes, and folders of them.
pub(super) fn manifest() -> String {
    let row = |n: usize| {
        let model = n as u64 % MODELS;
        if n >= ROWS - DEPENDENT {
            // Every fourth row makes a .glb.
            return format!("r{n},convert,out/r{}.glb,out/r{n}.ply,,\n", 4 * (n - (ROWS - DEPENDENT)));
        }
        match n % 4 {
            0 => format!("r{n},convert,m{model}.ply,out/r{n}.glb,,\n"),
            1 => format!("r{n},convert,m{model}.ply,out/deeper/r{n}.ply,,\n"),
            2 => format!("r{n},convert,m{model}.ply,out/r{n}.spz,true,\n"),
            _ => format!("r{n},convert,m{model}.ply,out/r{n},,3\n"),
        }
    };
    let rows: String = (0..ROWS).map(row).collect();
    format!("id,job,input,output,lossy,moments\n{rows}")
}

/// Does the manifest once without trouble.
pub(super) fn quiet(ground: &Ground) -> Result<Quiet> {
    let site = ground.site(&manifest())?;
    let begun = Instant::now();
    site.finish(&[], ROWS)?;
    let took = begun.elapsed();
    let litter = site.litter()?;
    check(litter.is_empty(), || format!("a quiet run leaves {litter:?}"))?;
    Ok(Quiet { made: site.made()?, took })
}

impl Tally {
    /// Brings a manifest to its end; an error unless it is then as after a quiet run.
    pub(super) fn settle(&mut self, site: &Site<'_>, quiet: &Quiet, more: &[&str]) -> Result<()> {
        site.finish(more, ROWS)?;
        self.look(site, quiet)
    }

    /// An error unless a manifest at its end is as after a quiet run.
    pub(super) fn look(&mut self, site: &Site<'_>, quiet: &Quiet) -> Result<()> {
        site.must_match(&quiet.made)?;
        let litter = site.litter()?;
        check(litter.is_empty(), || format!("left over: {litter:?}"))?;
        let records = site.records()?;
        self.farms += 1;
        self.begun_again += repeated(&records, "running");
        self.done_twice += repeated(&records, "done");
        self.failed += count(&records, "failed");
        check(repeated(&records, "done") == 0, || "a row is recorded as done twice".to_owned())
    }

    /// What it came to.
    pub(super) fn tell(&self, trouble: &str, figures: &mut Figures) {
        figures.add(&format!("{trouble}: runs in trouble"), self.troubled, "runs");
        figures.add(&format!("{trouble}: manifests brought to their end"), self.farms, "manifests");
        figures.add(&format!("{trouble}: rows begun again"), self.begun_again, "rows");
        figures.add(&format!("{trouble}: attempts that failed"), self.failed, "attempts");
        figures.add(&format!("{trouble}: rows recorded as done twice"), self.done_twice, "rows");
    }
}
