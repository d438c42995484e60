//! Which device a user asks for.

use std::str::FromStr;

use super::assignment::Assignment;
use super::info::{DeviceInfo, DeviceKind};
use crate::error::KernelError;

/// `auto`, `cpu`, an index of `guard4d devices`, `name:…`, `uuid:…` or `pci:…`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum DeviceSelect {
    /// The only GPU; a CPU driver where there is no GPU; an error when several GPUs are present.
    #[default]
    Auto,
    /// A software driver such as lavapipe.
    Cpu,
    /// Position in the loader's order.
    Index(usize),
    /// Case-insensitive part of the device name.
    Name(String),
    /// Prefix of the device UUID, hex, dashes ignored.
    Uuid(String),
    /// PCI address `domain:bus:device.function`, lower-case hex.
    Pci(String),
    /// What a scheduler gave; nobody types it.
    Assigned(Assignment),
}

impl FromStr for DeviceSelect {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let plain_hex = |v: &str| v.trim_start_matches("GPU-").replace('-', "").to_lowercase();
        match text.split_once(':') {
            None if text == "auto" => Ok(Self::Auto),
            None if text == "cpu" => Ok(Self::Cpu),
            None => text
                .parse()
                .map(Self::Index)
                .map_err(|_| format!("`{text}`: expected auto, cpu, a number, name:…, uuid:… or pci:…")),
            Some(("name", v)) => Ok(Self::Name(v.to_lowercase())),
            Some(("uuid", v)) => Ok(Self::Uuid(plain_hex(v))),
            Some(("pci", v)) => Ok(Self::Pci(v.to_lowercase())),
            Some((kind, _)) => Err(format!("`{kind}:`: expected name:, uuid: or pci:")),
        }
    }
}

impl std::fmt::Display for DeviceSelect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Index(i) => write!(f, "{i}"),
            Self::Name(v) => write!(f, "name:{v}"),
            Self::Uuid(v) => write!(f, "uuid:{v}"),
            Self::Pci(v) => write!(f, "pci:{v}"),
            Self::Assigned(assignment) => assignment.fmt(f),
        }
    }
}

impl DeviceSelect {
    /// For `auto` what a scheduler assigned, if one did; `variable` looks into the environment.
    #[must_use]
    pub fn or_assigned(self, variable: impl Fn(&str) -> Option<String>) -> Self {
        match (self, Assignment::read(variable)) {
            (Self::Auto, Some(assignment)) => Self::Assigned(assignment),
            (select, _) => select,
        }
    }

    /// Index of the device that this selection means.
    ///
    /// # Errors
    /// [`KernelError::NoDevice`] when none or, for `auto`, several GPUs fit.
    pub fn choose(&self, devices: &[DeviceInfo]) -> Result<usize, KernelError> {
        let is_cpu = |d: &DeviceInfo| d.kind == DeviceKind::Cpu;
        let found = match self {
            Self::Auto => {
                let mut gpus = (0..devices.len()).filter(|&i| !is_cpu(&devices[i]));
                match (gpus.next(), gpus.next()) {
                    (Some(gpu), None) => Some(gpu),
                    (Some(_), Some(_)) => None,
                    (None, _) => (!devices.is_empty()).then_some(0),
                }
            }
            Self::Cpu => devices.iter().position(is_cpu),
            Self::Index(i) => (*i < devices.len()).then_some(*i),
            Self::Name(part) => devices.iter().position(|d| d.name.to_lowercase().contains(part)),
            Self::Uuid(prefix) => devices.iter().position(|d| d.uuid.starts_with(prefix)),
            Self::Pci(address) => devices.iter().position(|d| d.pci.as_deref() == Some(address)),
            Self::Assigned(assignment) => assignment.choose(devices),
        };
        found.ok_or_else(|| KernelError::NoDevice {
            wanted: self.to_string(),
            present: devices.iter().enumerate().map(|(i, d)| format!("{i}: {}", d.name)).collect::<Vec<_>>().join(", "),
        })
    }
}
