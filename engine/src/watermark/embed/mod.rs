//! Embedding: optimising SH offsets so that rendered clips carry the message (Guard4D Sec. 3.3–3.5).

mod buffers;
mod checkpoint;
mod clips;
mod config;
mod copies;
mod draw;
mod embedding;
mod estimate;
mod extractor_loss;
mod fidelity_hold;
mod fidelity_loss;
mod fit;
mod fit_context;
mod foretold;
mod framed_views;
mod held_out;
mod offsets;
mod perception;
mod phases;
mod pool;
pub mod pretrain;
mod progress;
mod refit;
mod repeated;
mod report;
mod rotation_search;
mod scores;
mod step_inputs;
mod subject;
mod training_clip;
mod visibility;

pub use config::{
    AdaptiveSchedule, Aim, BlindConfig, CalibrationConfig, ColourConfig, ContentChoice, Control, ControlClips,
    EmbedConfig, Extractor, Fidelity, FramingChoice, JointConfig, LpipsTerm, NoneConfig, Objective, Optimiser, Phase,
    PretrainedConfig, Profile, TrainingCamera, TrainingViews, Weights, WeightsFile,
};
pub use embedding::Embedding;
pub use estimate::Estimate;
pub use pool::most_kept_bytes;
pub use refit::refit;
pub use repeated::Repetition;
pub use report::{HeldOutEvaluation, HeldOutReport, PhaseReport, StepReport, StopReason};
pub use subject::{Embedded, Start, Subject};
pub use visibility::most_visible;
