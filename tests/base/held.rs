//! What is held of one name at a time.

use guard4d_engine::base::held::Held;
use guard4d_engine::error::EngineError;

#[test]
fn what_is_held_is_loaded_once_and_what_failed_is_not_held() {
    let held = Held::default();
    let unwanted = || -> Result<u32, EngineError> { panic!("it is held") };
    assert_eq!(held.get("a", || Ok(1)).ok(), Some(1));
    assert_eq!(held.get("a", unwanted).ok(), Some(1));
    assert_eq!(held.get("b", || Ok(2)).ok(), Some(2), "another name");
    assert!(held.get("a", || Err(EngineError::Stopped)).is_err(), "the one before was forgotten");
    assert_eq!(held.get("a", || Ok(3)).ok(), Some(3), "a failure is tried again");
    assert_eq!(held.get("a", unwanted).ok(), Some(3));
    assert_eq!(held.held(), Some(3), "under whatever name");
    held.forget();
    assert_eq!(held.held(), None);
    assert_eq!(held.get("a", || Ok(4)).ok(), Some(4), "forgotten");
}
