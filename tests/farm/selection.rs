//! Shares of a manifest: every row in one of them, chains together, costs even.

use std::collections::BTreeMap;

use guard4d_engine::farm::selection::{RowNumbers, Selection, Shard};
use proptest::prelude::*;

use super::Farm;

fn shard(index: usize, count: usize) -> Selection {
    Selection { shard: Shard::new(index, count), ..Selection::default() }
}

#[test]
fn rows_are_numbers_and_ranges() {
    let farm = Farm::new(&["id,job,input,output", "a,j,x,1", "b,j,x,2", "c,j,x,3", "d,j,x,4", "e,j,x,5"]);
    let manifest = farm.manifest();
    let rows = |text: &str| {
        let numbers = Some(text.parse::<RowNumbers>().expect("rows"));
        Selection { numbers, ..Selection::default() }.places(&manifest)
    };
    assert_eq!(rows("0,2-3").expect("rows"), [0, 2, 3]);
    assert_eq!(rows("0-4:2").expect("rows"), [0, 2, 4]);
    assert_eq!(rows("4,4,1").expect("rows"), [1, 4], "each once");
    let error = rows("3-5").expect_err("five rows").to_string();
    assert!(error.contains('5') && error.contains("below 5"), "{error}");
    for wrong in ["", "a", "3-1", "1:0", "1-", "-1", "1,,2"] {
        assert!(wrong.parse::<RowNumbers>().is_err(), "`{wrong}`");
    }
    let ids = |ids: &[&str]| {
        Selection { ids: ids.iter().map(|id| (*id).to_owned()).collect(), ..Selection::default() }.places(&manifest)
    };
    assert_eq!(ids(&["d", "b"]).expect("ids"), [1, 3]);
    assert!(ids(&["z"]).expect_err("no such id").to_string().contains("`z`"), "the id is named");
}

#[test]
fn shards_are_numbers_of_a_count_or_tasks_of_an_array() {
    assert_eq!("2/3".parse::<Shard>().expect("a shard"), Shard::new(2, 3).expect("2 of 3"));
    for wrong in ["0/3", "4/3", "1", "a/b", "1/0"] {
        assert!(wrong.parse::<Shard>().is_err(), "`{wrong}`");
    }
    let array = |pairs: &[(&str, &str)]| {
        let variables: BTreeMap<String, String> =
            pairs.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
        Shard::of_array(|name| variables.get(name).cloned())
    };
    let slurm = |id| [("SLURM_ARRAY_TASK_ID", id), ("SLURM_ARRAY_TASK_MIN", "0"), ("SLURM_ARRAY_TASK_MAX", "15")];
    assert_eq!(array(&slurm("0")).expect("a task").place(), (1, 16));
    assert_eq!(array(&slurm("15")).expect("a task").place(), (16, 16));
    let by_five = [slurm("10").as_slice(), &[("SLURM_ARRAY_TASK_STEP", "5")]].concat();
    assert_eq!(array(&by_five).expect("a task").place(), (3, 4), "0, 5, 10, 15");
    let sge = [("SGE_TASK_ID", "3"), ("SGE_TASK_FIRST", "1"), ("SGE_TASK_LAST", "4"), ("SGE_TASK_STEPSIZE", "1")];
    assert_eq!(array(&sge).expect("a task").place(), (3, 4));
    let none = array(&[("SGE_TASK_ID", "undefined")]).expect_err("no array").to_string();
    assert!(none.contains("auto") && none.contains("I/N"), "{none}");
}

#[test]
fn what_is_needed_comes_first_and_then_the_longest() {
    let farm = Farm::new(&[
        "id,job,input,output,cost,key",
        "film,render,marked,a.mp4,9,",
        "short,embed,b.ply,b,1,owner.key",
        "long,embed,a.ply,marked,5,owner.key",
        "key,keygen,,owner.key,0,",
    ]);
    let manifest = farm.manifest();
    assert_eq!(Selection::default().places(&manifest).expect("all"), [3, 2, 1, 0]);
    // The film alone brings what it needs.
    let ids = vec!["film".to_owned()];
    assert_eq!(Selection { ids, ..Selection::default() }.places(&manifest).expect("a chain"), [3, 2, 0]);
    // The film stays with its model; both shards know the key, and whoever comes first makes it.
    let shards = [1, 2].map(|index| shard(index, 2).places(&manifest).expect("a shard"));
    assert_eq!(shards, [vec![3, 2, 0], vec![3, 1]]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn every_row_is_in_one_shard_and_loads_are_even(
        costs in prop::collection::vec(0.0f64..100.0, 1..60),
        count in 1usize..8,
    ) {
        let rows: Vec<String> = costs.iter().enumerate().map(|(i, cost)| format!("r{i},j,in,out{i},{cost}")).collect();
        let head = std::iter::once("id,job,input,output,cost");
        let lines: Vec<&str> = head.chain(rows.iter().map(String::as_str)).collect();
        let manifest = Farm::new(&lines).manifest();
        let shards: Vec<Vec<usize>> =
            (1..=count).map(|index| shard(index, count).places(&manifest).expect("a shard")).collect();
        let mut all = shards.concat();
        all.sort_unstable();
        prop_assert_eq!(all, (0..costs.len()).collect::<Vec<_>>());
        let mut loads: Vec<f64> = shards.iter().map(|places| places.iter().map(|place| costs[*place]).sum()).collect();
        loads.sort_by(f64::total_cmp);
        let (low, high) = (loads[0], loads[count - 1]);
        // Whoever has most got its last row when it had least.
        let mut longest = costs.clone();
        longest.sort_by(f64::total_cmp);
        let longest = longest[costs.len() - 1];
        prop_assert!(high - low <= longest + 1e-9, "{:?}", loads);
    }
}

#[test]
fn rows_without_a_cost_go_round() {
    let rows: Vec<String> = (0..10).map(|i| format!("r{i},j,in,out{i}")).collect();
    let lines: Vec<&str> = std::iter::once("id,job,input,output").chain(rows.iter().map(String::as_str)).collect();
    let manifest = Farm::new(&lines).manifest();
    assert_eq!(shard(2, 4).places(&manifest).expect("a shard"), [1, 5, 9]);
}
