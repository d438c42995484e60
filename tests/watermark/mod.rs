mod evidence;
mod message;
mod metrics;
mod prf;
mod receipt;
mod statistics;
mod tokens;
