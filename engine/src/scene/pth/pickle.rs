//! A pickle machine that knows the opcodes and globals of a state dict and refuses all others.
//!
//! Values are small copies: strings borrow from the program, containers are indices into arenas that memo and
//! stack share. So a memo of nested doublings stays as small as its program, and dropping never recurses.

use std::collections::{HashMap, HashSet};

use super::flaw::Flaw;
use super::tensor::{Dtype, Storage, View};

mod opcode;

use super::pickle::opcode as op;

/// Most opcodes that are run; a state dict of 49 tensors needs about 2,500.
const MAX_STEPS: usize = 1_000_000;

/// Most dimensions of a tensor; HexPlane planes have four.
const MAX_DIMS: usize = 8;

/// What a program leaves on the stack.
pub(super) enum Root<'a> {
    StateDict(Vec<(&'a str, View<'a>)>),
    Tensor(View<'a>),
}

/// The allow-list of importable names.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Global {
    OrderedDict,
    RebuildTensor,
    RebuildParameter,
    Storage(Dtype),
}

impl Global {
    fn find(module: &str, name: &str) -> Option<Self> {
        Some(match (module, name) {
            ("collections", "OrderedDict") => Self::OrderedDict,
            ("torch._utils", "_rebuild_tensor_v2") => Self::RebuildTensor,
            ("torch._utils", "_rebuild_parameter") => Self::RebuildParameter,
            ("torch", storage) => Self::Storage(Dtype::from_storage(storage)?),
            _ => return None,
        })
    }
}

#[derive(Clone, Copy, Debug)]
enum Value<'a> {
    Mark,
    None,
    Bool,
    Int(i64),
    Float,
    Str(&'a str),
    Global(Global),
    Storage(Storage<'a>),
    /// Index into [`Machine::sequences`].
    Tuple(usize),
    /// Lists are accepted where torch writes them, and never looked into.
    List,
    /// Index into [`Machine::dicts`].
    Dict(usize),
    /// Index into [`Machine::views`].
    Tensor(usize),
}

/// The machine's state while a program runs.
pub(super) struct Machine<'a> {
    program: &'a [u8],
    at: usize,
    stack: Vec<Value<'a>>,
    memo: HashMap<u32, Value<'a>>,
    sequences: Vec<Vec<Value<'a>>>,
    dicts: Vec<Vec<(Value<'a>, Value<'a>)>>,
    views: Vec<View<'a>>,
}

impl<'a> Machine<'a> {
    /// Runs `program` to its end.
    pub(super) fn run(program: &'a [u8]) -> Result<Root<'a>, Flaw> {
        let mut machine = Self {
            program,
            at: 0,
            stack: Vec::new(),
            memo: HashMap::new(),
            sequences: Vec::new(),
            dicts: Vec::new(),
            views: Vec::new(),
        };
        for _ in 0..MAX_STEPS {
            let start = machine.at;
            let [code] = machine.take()?;
            if code == op::STOP {
                return machine.finish();
            }
            machine.step(code).map_err(|mut flaw| {
                flaw.field = format!("data.pkl byte {start}");
                flaw
            })?;
        }
        let expected = format!("at most {MAX_STEPS} opcodes");
        Err(Flaw::new("data.pkl", "a longer program", expected))
    }

    fn step(&mut self, code: u8) -> Result<(), Flaw> {
        match code {
            op::PROTO => self.protocol(),
            op::MARK => self.push(Value::Mark),
            op::NONE => self.push(Value::None),
            op::NEWTRUE | op::NEWFALSE => self.push(Value::Bool),
            op::BININT | op::BININT1 | op::BININT2 | op::LONG1 => self.integer(code),
            op::BINFLOAT => {
                self.take::<8>()?;
                self.push(Value::Float)
            }
            op::BINUNICODE => {
                let text = self.text()?;
                self.push(Value::Str(text))
            }
            op::GLOBAL => self.global(),
            op::BINPUT | op::LONG_BINPUT => self.memo_put(code),
            op::BINGET | op::LONG_BINGET => self.memo_get(code),
            op::EMPTY_TUPLE => self.tuple(Vec::new()),
            op::TUPLE1 => self.tuple_of(1),
            op::TUPLE2 => self.tuple_of(2),
            op::TUPLE3 => self.tuple_of(3),
            op::TUPLE => {
                let items = self.pop_to_mark()?;
                self.tuple(items)
            }
            op::EMPTY_LIST => self.push(Value::List),
            op::APPEND => {
                self.pop()?;
                self.expect_list()
            }
            op::APPENDS => {
                self.pop_to_mark()?;
                self.expect_list()
            }
            op::EMPTY_DICT => self.new_dict(),
            op::SETITEM => {
                let value = self.pop()?;
                let key = self.pop()?;
                self.set_items(&[key, value])
            }
            op::SETITEMS => {
                let items = self.pop_to_mark()?;
                self.set_items(&items)
            }
            op::BINPERSID => self.storage(),
            op::REDUCE => self.reduce(),
            op::BUILD => self.build(),
            _ => Err(refuse(format!("opcode {code:#04x}"), "an opcode of a state dict")),
        }
    }

    fn protocol(&mut self) -> Result<(), Flaw> {
        match self.take()? {
            [op::PROTOCOL] => Ok(()),
            [other] => Err(refuse(
                format!("pickle protocol {other}"),
                format!("protocol {}, as torch.save writes", op::PROTOCOL),
            )),
        }
    }

    fn integer(&mut self, code: u8) -> Result<(), Flaw> {
        let value = match code {
            op::BININT => i64::from(i32::from_le_bytes(self.take()?)),
            op::BININT1 => i64::from(u8::from_le_bytes(self.take()?)),
            op::BININT2 => i64::from(u16::from_le_bytes(self.take()?)),
            _ => self.long()?,
        };
        self.push(Value::Int(value))
    }

    /// A two's-complement little-endian integer of up to eight bytes.
    fn long(&mut self) -> Result<i64, Flaw> {
        let [length] = self.take()?;
        let bytes = self.slice(usize::from(length))?;
        let fill = match bytes.last() {
            Some(last) if last & 0x80 != 0 => 0xFF,
            _ => 0,
        };
        let mut wide = [fill; size_of::<i64>()];
        let target = wide
            .get_mut(..bytes.len())
            .ok_or_else(|| refuse(format!("an integer of {length} bytes"), "at most 8 bytes"))?;
        target.copy_from_slice(bytes);
        Ok(i64::from_le_bytes(wide))
    }

    fn text(&mut self) -> Result<&'a str, Flaw> {
        let length = u32::from_le_bytes(self.take()?);
        let bytes = self.slice(length as usize)?;
        std::str::from_utf8(bytes).map_err(|_| refuse("a string that is no text", "UTF-8"))
    }

    fn global(&mut self) -> Result<(), Flaw> {
        let module = self.line()?;
        let name = self.line()?;
        let global = Global::find(module, name).ok_or_else(|| {
            let got = format!("global `{module}.{name}`");
            refuse(got, "only tensors; the file may be malicious and was not run")
        })?;
        self.push(Value::Global(global))
    }

    fn line(&mut self) -> Result<&'a str, Flaw> {
        let rest = &self.program[self.at..];
        let length = rest.iter().position(|&byte| byte == b'\n');
        let length = length.ok_or_else(|| refuse("a name without end", "a line"))?;
        let line = self.slice(length)?;
        self.at += 1;
        std::str::from_utf8(line).map_err(|_| refuse("a name that is no text", "UTF-8"))
    }

    fn memo_index(&mut self, code: u8) -> Result<u32, Flaw> {
        Ok(match code {
            op::BINPUT | op::BINGET => u32::from(u8::from_le_bytes(self.take()?)),
            _ => u32::from_le_bytes(self.take()?),
        })
    }

    fn memo_put(&mut self, code: u8) -> Result<(), Flaw> {
        let index = self.memo_index(code)?;
        let top = *self.stack.last().ok_or_else(underflow)?;
        self.memo.insert(index, top);
        Ok(())
    }

    fn memo_get(&mut self, code: u8) -> Result<(), Flaw> {
        let index = self.memo_index(code)?;
        let value = self.memo.get(&index).copied();
        let value = value.ok_or_else(|| refuse(format!("memo {index}"), "a memo set before"))?;
        self.push(value)
    }

    fn tuple_of(&mut self, count: usize) -> Result<(), Flaw> {
        let start = self.stack.len().checked_sub(count);
        let items = self.stack.split_off(start.ok_or_else(underflow)?);
        if items.iter().any(|item| matches!(item, Value::Mark)) {
            return Err(underflow());
        }
        self.tuple(items)
    }

    fn tuple(&mut self, items: Vec<Value<'a>>) -> Result<(), Flaw> {
        self.sequences.push(items);
        self.push(Value::Tuple(self.sequences.len() - 1))
    }

    fn new_dict(&mut self) -> Result<(), Flaw> {
        self.dicts.push(Vec::new());
        self.push(Value::Dict(self.dicts.len() - 1))
    }

    fn set_items(&mut self, items: &[Value<'a>]) -> Result<(), Flaw> {
        let Some(&Value::Dict(dict)) = self.stack.last() else {
            return Err(refuse("items for something else", "a dict"));
        };
        let (pairs, []) = items.as_chunks() else {
            return Err(refuse("a key without value", "pairs"));
        };
        self.dicts[dict].extend(pairs.iter().map(|&[key, value]| (key, value)));
        Ok(())
    }

    fn expect_list(&mut self) -> Result<(), Flaw> {
        match self.stack.last() {
            Some(Value::List) => Ok(()),
            _ => Err(refuse("items for something else", "a list")),
        }
    }

    /// A persistent id: `('storage', torch.XStorage, key, location, count)`; the location does not matter.
    fn storage(&mut self) -> Result<(), Flaw> {
        let id = self.pop()?;
        let storage = match *self.items(id)? {
            [
                Value::Str("storage"),
                Value::Global(Global::Storage(dtype)),
                Value::Str(key),
                Value::Str(_),
                Value::Int(count),
            ] => Storage { dtype, key, count: size(count)? },
            _ => return Err(refuse("another persistent id", "a torch storage")),
        };
        self.push(Value::Storage(storage))
    }

    fn reduce(&mut self) -> Result<(), Flaw> {
        let arguments = self.pop()?;
        let callable = self.pop()?;
        let arguments = self.items(arguments)?;
        match (callable, arguments) {
            (Value::Global(Global::OrderedDict), []) => self.new_dict(),
            (
                Value::Global(Global::RebuildTensor),
                &[Value::Storage(storage), Value::Int(offset), shape, strides, Value::Bool, Value::Dict(_), ..],
            ) => {
                let view =
                    View { storage, offset: size(offset)?, shape: self.sizes(shape)?, strides: self.sizes(strides)? };
                self.views.push(view);
                self.push(Value::Tensor(self.views.len() - 1))
            }
            (Value::Global(Global::RebuildParameter), &[tensor @ Value::Tensor(_), Value::Bool, Value::Dict(_)]) => {
                self.push(tensor)
            }
            _ => Err(refuse("a call that builds no tensor", "tensors and OrderedDict()")),
        }
    }

    /// Attributes of a dict (torch's `_metadata`): dropped.
    fn build(&mut self) -> Result<(), Flaw> {
        self.pop()?;
        match self.stack.last() {
            Some(Value::Dict(_)) => Ok(()),
            _ => Err(refuse("attributes for something else", "a state dict")),
        }
    }

    fn sizes(&self, tuple: Value<'a>) -> Result<Vec<usize>, Flaw> {
        let items = self.items(tuple)?;
        if items.len() > MAX_DIMS {
            let got = format!("{} dimensions", items.len());
            return Err(refuse(got, format!("at most {MAX_DIMS}")));
        }
        let sizes = items.iter().map(|item| match item {
            Value::Int(value) => size(*value),
            _ => Err(refuse("sizes that are no integers", "integers")),
        });
        sizes.collect()
    }

    fn items(&self, value: Value<'a>) -> Result<&[Value<'a>], Flaw> {
        match value {
            Value::Tuple(index) => Ok(&self.sequences[index]),
            _ => Err(refuse("something else", "a tuple")),
        }
    }

    fn push(&mut self, value: Value<'a>) -> Result<(), Flaw> {
        self.stack.push(value);
        Ok(())
    }

    fn pop(&mut self) -> Result<Value<'a>, Flaw> {
        match self.stack.pop() {
            None | Some(Value::Mark) => Err(underflow()),
            Some(value) => Ok(value),
        }
    }

    fn pop_to_mark(&mut self) -> Result<Vec<Value<'a>>, Flaw> {
        let is_mark = |value: &Value<'_>| matches!(value, Value::Mark);
        let mark = self.stack.iter().rposition(is_mark);
        let mark = mark.ok_or_else(underflow)?;
        let items = self.stack.split_off(mark + 1);
        self.stack.pop();
        Ok(items)
    }

    fn slice(&mut self, length: usize) -> Result<&'a [u8], Flaw> {
        let rest = &self.program[self.at..];
        let slice = rest.get(..length).ok_or_else(|| {
            let field = format!("data.pkl byte {}", self.at);
            Flaw::new(field, "end of program", format!("{length} more bytes"))
        })?;
        self.at += length;
        Ok(slice)
    }

    fn take<const LENGTH: usize>(&mut self) -> Result<[u8; LENGTH], Flaw> {
        let slice = self.slice(LENGTH)?;
        Ok(*slice.first_chunk().expect("`slice` returns as many bytes as asked"))
    }

    fn finish(mut self) -> Result<Root<'a>, Flaw> {
        let root = self.stack.pop();
        if self.at != self.program.len() || !self.stack.is_empty() {
            return Err(Flaw::new("data.pkl", "more after its end", "one value"));
        }
        match root {
            Some(Value::Tensor(index)) => Ok(Root::Tensor(self.views.swap_remove(index))),
            Some(Value::Dict(index)) => self.state_dict(index),
            _ => {
                let expected = "a state dict or a tensor";
                Err(Flaw::new("data.pkl", "another root", expected))
            }
        }
    }

    fn state_dict(self, index: usize) -> Result<Root<'a>, Flaw> {
        let mut names = HashSet::new();
        let mut tensors = Vec::with_capacity(self.dicts[index].len());
        for &(key, value) in &self.dicts[index] {
            let Value::Str(name) = key else {
                return Err(Flaw::new("state dict", "a key that is no string", "names"));
            };
            let Value::Tensor(view) = value else {
                let field = format!("`{name}`");
                return Err(Flaw::new(field, "something else", "a tensor"));
            };
            if !names.insert(name) {
                return Err(Flaw::new(format!("`{name}`"), "present twice", "each name once"));
            }
            tensors.push((name, self.views[view].clone()));
        }
        Ok(Root::StateDict(tensors))
    }
}

fn size(value: i64) -> Result<usize, Flaw> {
    usize::try_from(value).map_err(|_| refuse(value.to_string(), "a size of at least 0"))
}

fn underflow() -> Flaw {
    refuse("too few values on the stack", "a complete program")
}

/// A flaw of the opcode being run; [`Machine::run`] fills in where that is.
fn refuse(got: impl Into<String>, expected: impl Into<String>) -> Flaw {
    Flaw::new("data.pkl", got, expected)
}
