//! Which rows of a manifest one worker takes. It depends on the manifest and on what was asked for alone, so that
//! workers agree without a word.

use std::cmp::{Ordering, Reverse};
use std::collections::{BinaryHeap, HashMap, HashSet};
use std::str::FromStr;

use serde::Serialize;

use super::manifest::{Manifest, Row};
use crate::error::EngineError;

/// Rows by their numbers, from 0: `0,3,5-9` or with a step `0-99:4`. OpenJD and Slurm write lists like that.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RowNumbers(Vec<Span>);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Span {
    first: usize,
    last: usize,
    step: usize,
}

/// A share of all rows: number `index` of `count`, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: usize,
    count: usize,
}

/// What a worker was asked to take.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Rows by number; all of them if `None`.
    pub numbers: Option<RowNumbers>,
    /// Rows by id; all of them if empty.
    pub ids: Vec<String>,
    /// A share of these.
    pub shard: Option<Shard>,
}

/// What a shard has to do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    /// How many rows.
    pub rows: usize,
    /// Sum of their costs.
    pub cost: f64,
}

/// Why something is neither rows nor a shard.
fn wrong(what: &str, got: &str, expected: &str) -> EngineError {
    EngineError::Usage { what: what.to_owned(), got: format!("`{got}`"), expected: expected.to_owned() }
}

impl FromStr for RowNumbers {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        let bad = || wrong("rows", text, "numbers and ranges from 0 on, such as 0,3,5-9 or 0-99:4");
        let number = |text: &str| text.trim().parse::<usize>().map_err(|_| bad());
        let span = |part: &str| {
            let (range, step) =
                part.split_once(':').map_or((part, 1), |(range, step)| (range, number(step).unwrap_or(0)));
            let (first, last) = range.split_once('-').unwrap_or((range, range));
            let span = Span { first: number(first)?, last: number(last)?, step };
            if span.first <= span.last && step > 0 { Ok(span) } else { Err(bad()) }
        };
        Ok(Self(text.split(',').map(span).collect::<Result<_, _>>()?))
    }
}

impl FromStr for Shard {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        let bad = || wrong("shard", text, "I/N with I from 1 to N");
        let (index, count) = text.split_once('/').ok_or_else(bad)?;
        let number = |text: &str| text.trim().parse::<usize>().map_err(|_| bad());
        Self::new(number(index)?, number(count)?).ok_or_else(bad)
    }
}

/// A scheduler's variables for the place of a task in an array: its index, the smallest and the largest index, and the
/// step between two.
struct ArrayVariables {
    index: &'static str,
    min: &'static str,
    max: &'static str,
    step: &'static str,
}

/// Slurm and SGE. Of other schedulers a task learns its index, but not how many there are.
const ARRAYS: [ArrayVariables; 2] = [
    ArrayVariables {
        index: "SLURM_ARRAY_TASK_ID",
        min: "SLURM_ARRAY_TASK_MIN",
        max: "SLURM_ARRAY_TASK_MAX",
        step: "SLURM_ARRAY_TASK_STEP",
    },
    ArrayVariables { index: "SGE_TASK_ID", min: "SGE_TASK_FIRST", max: "SGE_TASK_LAST", step: "SGE_TASK_STEPSIZE" },
];

impl Shard {
    /// Number `index` of `count`, from 1; `None` for a number that there is not.
    #[must_use]
    pub fn new(index: usize, count: usize) -> Option<Self> {
        (1..=count).contains(&index).then_some(Self { index, count })
    }

    /// Its number, from 1, and the count.
    #[must_use]
    pub const fn place(self) -> (usize, usize) {
        (self.index, self.count)
    }

    /// The place of this task in the array that a scheduler runs, from its variables. An array of which some tasks were
    /// left out has shards without a worker: those rows are for the next run.
    ///
    /// # Errors
    /// [`EngineError::Usage`] where no scheduler says it.
    pub fn of_array(variable: impl Fn(&str) -> Option<String>) -> Result<Self, EngineError> {
        let number = |name: &str| variable(name).and_then(|text| text.parse::<usize>().ok());
        ARRAYS
            .iter()
            .find_map(|array| {
                let (index, min, max) = (number(array.index)?, number(array.min)?, number(array.max)?);
                let step = number(array.step).unwrap_or(1).max(1);
                Self::new(index.checked_sub(min)? / step + 1, max.checked_sub(min)? / step + 1)
            })
            .ok_or_else(|| wrong("shard", "auto", "a task of an array of Slurm or SGE; else I/N"))
    }
}

impl Selection {
    /// Places of the chosen rows in the manifest, and of the rows that they need, in the order in which they are done:
    /// what others need first, then the longest first.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for an id or a number that no row has.
    pub fn places(&self, manifest: &Manifest) -> Result<Vec<usize>, EngineError> {
        let rows = manifest.rows();
        let chosen = self.chosen(rows)?;
        let mine = match self.shard {
            Some(Shard { index, count }) => deal(rows, &chosen, count).swap_remove(index - 1),
            None => chosen,
        };
        let mut places = with_needs(rows, mine);
        places.sort_by(|&a, &b| {
            let (one, other) = (&rows[a], &rows[b]);
            one.stage.cmp(&other.stage).then(other.cost.total_cmp(&one.cost)).then(a.cmp(&b))
        });
        Ok(places)
    }

    /// What each of `count` shards has to do of the chosen rows. Rows that one needs of another are not counted.
    ///
    /// # Errors
    /// Those of [`Self::places`].
    pub fn shares(&self, manifest: &Manifest, count: usize) -> Result<Vec<Share>, EngineError> {
        let rows = manifest.rows();
        let dealt = deal(rows, &self.chosen(rows)?, count);
        let share = |places: &Vec<usize>| Share {
            rows: places.len(),
            cost: places.iter().map(|place| rows[*place].cost).sum(),
        };
        Ok(dealt.iter().map(share).collect())
    }

    /// Places before shards are dealt, ascending.
    fn chosen(&self, rows: &[Row]) -> Result<Vec<usize>, EngineError> {
        let mut is_chosen = vec![self.numbers.is_none() && self.ids.is_empty(); rows.len()];
        for Span { first, last, step } in self.numbers.iter().flat_map(|numbers| &numbers.0).copied() {
            if last >= rows.len() {
                let expected = format!("numbers below {}, as there are rows", rows.len());
                return Err(wrong("rows", &last.to_string(), &expected));
            }
            (first..=last).step_by(step).for_each(|place| is_chosen[place] = true);
        }
        if !self.ids.is_empty() {
            let places: HashMap<&str, usize> = rows.iter().enumerate().map(|(i, row)| (row.id.as_str(), i)).collect();
            for id in &self.ids {
                let place = places.get(id.as_str()).ok_or_else(|| wrong("ids", id, "ids of the manifest"))?;
                is_chosen[*place] = true;
            }
        }
        Ok((0..rows.len()).filter(|place| is_chosen[*place]).collect())
    }
}

/// The chosen rows of each of `count` shards. A row stays with the one that makes its input. Such groups are dealt
/// longest first, each to the shard that has the least to do; equal ones go round.
fn deal(rows: &[Row], chosen: &[usize], count: usize) -> Vec<Vec<usize>> {
    let mut is_chosen = vec![false; rows.len()];
    chosen.iter().for_each(|place| is_chosen[*place] = true);
    let mut groups = Groups::new(rows.len());
    for &place in chosen {
        if let Some(source) = rows[place].source.filter(|source| is_chosen[*source]) {
            groups.join(place, source);
        }
    }
    let mut costs = vec![0.0; rows.len()];
    for &place in chosen {
        costs[groups.first(place)] += rows[place].cost;
    }
    let mut order: Vec<usize> = chosen.iter().copied().filter(|place| groups.first(*place) == *place).collect();
    order.sort_by(|a, b| costs[*b].total_cmp(&costs[*a]).then(a.cmp(b)));
    // The shard with the least to do on top, of equal ones the first.
    let mut loads: BinaryHeap<_> = (0..count).map(|index| Reverse((Load::default(), index))).collect();
    let mut shard_of = vec![0; rows.len()];
    for group in order {
        let Reverse((load, index)) = loads.pop().expect("there is a shard");
        shard_of[group] = index;
        loads.push(Reverse((Load { cost: load.cost + costs[group], groups: load.groups + 1 }, index)));
    }
    let mut dealt = vec![Vec::new(); count];
    chosen.iter().for_each(|place| dealt[shard_of[groups.first(*place)]].push(*place));
    dealt
}

/// What a shard has so far. How many groups that is tells rows without a cost apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Load {
    cost: f64,
    groups: usize,
}

impl Eq for Load {}

impl Ord for Load {
    fn cmp(&self, other: &Self) -> Ordering {
        self.cost.total_cmp(&other.cost).then(self.groups.cmp(&other.groups))
    }
}

impl PartialOrd for Load {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Rows that are joined, by the first of each group.
struct Groups(Vec<usize>);

impl Groups {
    fn new(rows: usize) -> Self {
        Self((0..rows).collect())
    }

    fn first(&mut self, place: usize) -> usize {
        let mut at = place;
        while self.0[at] != at {
            self.0[at] = self.0[self.0[at]];
            at = self.0[at];
        }
        at
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.first(a), self.first(b));
        self.0[a.max(b)] = a.min(b);
    }
}

/// The rows, and all that they need.
fn with_needs(rows: &[Row], places: Vec<usize>) -> Vec<usize> {
    let mut is_in: HashSet<usize> = places.iter().copied().collect();
    let mut found = places;
    let mut next = 0;
    while let Some(&place) = found.get(next) {
        found.extend(rows[place].needs.iter().copied().filter(|need| is_in.insert(*need)));
        next += 1;
    }
    found
}
