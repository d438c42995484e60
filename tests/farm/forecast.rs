//! Forecasts: what is left, by what is done and by what was tried.

use guard4d_engine::farm::forecast::{Forecast, Trial, bytes_of};
use guard4d_engine::farm::journal::Journal;
use guard4d_engine::farm::record::{Record, State};
use serde_json::json;

use super::Farm;

#[test]
fn what_is_left_takes_what_done_rows_took_by_their_costs() {
    let farm = Farm::new(&[
        "id,job,input,output,cost",
        "small,embed,x,small.out,1",
        "large,embed,x,large.out,3",
        "left,embed,x,left.out,8",
        "failed,embed,x,failed.out,100",
        "film,render,x,film.out,1",
    ]);
    let manifest = farm.manifest();
    farm.put("small.out", &"s".repeat(100));
    farm.put("large.out", &"l".repeat(300));
    let mut journal = Journal::open(&manifest.state(), "one").expect("readable");
    for (place, state, seconds, peak) in
        [(0, State::Done, 10.0, 500), (1, State::Done, 30.0, 900), (3, State::Failed, 1.0, 9000)]
    {
        let row = &manifest.rows()[place];
        let begun = Record::begun(&row.id, &row.job, 1, row.settings_hash(), "one");
        let result = json!({ "marked": 1.0, "peak_memory_bytes": peak, "psnr": { "peak_memory_bytes": 1 } });
        journal.add(&[Record { state, seconds, result, ..begun }]).expect("writable");
    }
    // As another process reads it, too.
    for journal in [journal, Journal::open(&manifest.state(), "two").expect("readable")] {
        let forecasts = Forecast::of(&manifest, &journal.of_rows(manifest.rows()));
        let embed = &forecasts["embed"];
        assert_eq!((embed.done, embed.left), (2, 1), "who failed is not tried again");
        assert_eq!(embed.seconds, Some(80.0), "40 s for costs of 4, and 8 are left");
        assert_eq!(embed.device_bytes, Some(900), "the most of those that are done");
        assert_eq!(embed.disk_bytes, Some(800), "200 bytes in the mean, for four times a mean row");
        let render = &forecasts["render"];
        assert_eq!((render.left, render.seconds, render.device_bytes, render.disk_bytes), (1, None, None, None));
    }
}

#[test]
fn a_row_that_was_tried_speaks_for_all_of_its_job() {
    let farm = Farm::new(&["id,job,input,output,cost", "a,embed,a.ply,a,2", "b,embed,b.ply,b,4"]);
    farm.put("a.ply", "0123456789");
    farm.put("b.ply", "01234");
    let manifest = farm.manifest();
    let mut forecast = Forecast { left: 2, ..Forecast::default() };
    let left: Vec<_> = manifest.rows().iter().collect();
    let trial = Trial { seconds: 10.0, device_bytes: 7, added_bytes: 100 };
    forecast.take(&manifest, left[0], trial, &left);
    let want = Forecast {
        left: 2,
        seconds: Some(30.0),
        device_bytes: Some(7),
        disk_bytes: Some(10 + 5 + 200),
        tried: Some("a".to_owned()),
        ..Forecast::default()
    };
    assert_eq!(forecast, want);
    assert_eq!(bytes_of(&manifest, "none"), 0, "what is not there takes nothing");
}
