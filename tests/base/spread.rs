//! A few of many are spread evenly.

use guard4d_engine::base::spread::spread;

#[test]
fn a_few_of_many_are_the_middles_of_equal_parts() {
    let of = |len, count| spread(len, count).collect::<Vec<usize>>();
    assert_eq!(of(9, 3), [1, 4, 7]);
    assert_eq!(of(10, 2), [2, 7]);
    assert_eq!(of(7, 1), [3]);
    assert_eq!(of(3, 5), [0, 1, 2], "no more than there are");
    assert_eq!((of(0, 4), of(4, 0)), (vec![], vec![]));
}
