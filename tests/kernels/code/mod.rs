//! Tests of `code`.

mod copy_score;
