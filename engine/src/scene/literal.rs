//! Python literals, parsed and never evaluated: the value syntax of `cfg_args`.

/// Deepest nesting of lists and dicts; `cfg_args` needs two.
const MAX_DEPTH: usize = 8;

/// A Python literal of the kinds that hyperparameters have.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Literal {
    None,
    Bool(bool),
    Int(i64),
    Float(f64),
    Str(String),
    List(Vec<Self>),
    Dict(Vec<(Self, Self)>),
}

impl Literal {
    /// The kind's Python name and, for scalars, the value: for error messages.
    pub(super) fn describe(&self) -> String {
        match self {
            Self::None => "None".to_owned(),
            Self::Bool(true) => "True".to_owned(),
            Self::Bool(false) => "False".to_owned(),
            Self::Int(value) => value.to_string(),
            Self::Float(value) => value.to_string(),
            Self::Str(value) => format!("'{value}'"),
            Self::List(items) => format!("a list of {}", items.len()),
            Self::Dict(items) => format!("a dict of {}", items.len()),
        }
    }
}

/// Where parsing stopped, and why.
#[derive(Debug, PartialEq)]
pub(super) struct SyntaxError {
    /// Byte offset in the text.
    pub(super) at: usize,
    /// What stands there.
    pub(super) got: String,
    /// What could have stood there.
    pub(super) expected: &'static str,
}

/// Parses `Namespace(name=literal, ...)` into its pairs, in file order.
pub(super) fn parse_namespace(text: &str) -> Result<Vec<(String, Literal)>, SyntaxError> {
    let mut parser = Parser { text, at: 0 };
    parser.expect("Namespace(", "`Namespace(`")?;
    let pairs = parser.separated(")", |parser| {
        let name = parser.identifier()?;
        parser.expect("=", "`=`")?;
        Ok((name, parser.literal(0)?))
    })?;
    parser.skip_space();
    match parser.rest() {
        "" => Ok(pairs),
        _ => Err(parser.error("the end of the file")),
    }
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Parser<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn error(&self, expected: &'static str) -> SyntaxError {
        let got: String = self.rest().chars().take(20).collect();
        let got = match got.as_str() {
            "" => "end of file".to_owned(),
            _ => format!("`{}`", got.escape_debug()),
        };
        SyntaxError { at: self.at, got, expected }
    }

    fn skip_space(&mut self) {
        self.at = self.text.len() - self.rest().trim_ascii_start().len();
    }

    /// Skips space, then `token` if it stands there.
    fn eat(&mut self, token: &str) -> bool {
        self.skip_space();
        let found = self.rest().starts_with(token);
        if found {
            self.at += token.len();
        }
        found
    }

    fn expect(&mut self, token: &str, expected: &'static str) -> Result<(), SyntaxError> {
        match self.eat(token) {
            true => Ok(()),
            false => Err(self.error(expected)),
        }
    }

    /// Comma-separated items up to `close`; a comma before `close` is accepted, as in Python.
    fn separated<T>(
        &mut self,
        close: &str,
        mut item: impl FnMut(&mut Self) -> Result<T, SyntaxError>,
    ) -> Result<Vec<T>, SyntaxError> {
        let mut items = Vec::new();
        while !self.eat(close) {
            items.push(item(self)?);
            if !self.eat(",") {
                match self.eat(close) {
                    true => break,
                    false => return Err(self.error("`,` or a closing bracket")),
                }
            }
        }
        Ok(items)
    }

    /// The longest prefix of characters that satisfy `accept`.
    fn take_while(&mut self, accept: impl Fn(char) -> bool) -> &'a str {
        let rest = self.rest();
        let length = rest.find(|c| !accept(c)).unwrap_or(rest.len());
        self.at += length;
        &rest[..length]
    }

    fn identifier(&mut self) -> Result<String, SyntaxError> {
        self.skip_space();
        let start = self.at;
        let name = self.take_while(|c| c.is_ascii_alphanumeric() || c == '_');
        if name.is_empty() || name.starts_with(|c: char| c.is_ascii_digit()) {
            self.at = start;
            return Err(self.error("a name"));
        }
        Ok(name.to_owned())
    }

    fn literal(&mut self, depth: usize) -> Result<Literal, SyntaxError> {
        self.skip_space();
        if depth > MAX_DEPTH {
            return Err(self.error("shallower nesting"));
        }
        match self.rest().chars().next() {
            Some(quote @ ('\'' | '"')) => self.string(quote).map(Literal::Str),
            Some('[') => {
                self.at += 1;
                let items = self.separated("]", |parser| parser.literal(depth + 1))?;
                Ok(Literal::List(items))
            }
            Some('{') => {
                self.at += 1;
                let pairs = self.separated("}", |parser| {
                    let key = parser.literal(depth + 1)?;
                    parser.expect(":", "`:`")?;
                    Ok((key, parser.literal(depth + 1)?))
                })?;
                Ok(Literal::Dict(pairs))
            }
            Some('-' | '+' | '.' | '0'..='9') => self.number(),
            _ => self.word(),
        }
    }

    fn number(&mut self) -> Result<Literal, SyntaxError> {
        let start = self.at;
        let word = self.take_while(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '+' | '-' | '_'));
        let integer = word.parse().map(Literal::Int).ok();
        let float = || word.parse().ok().filter(|f: &f64| f.is_finite());
        integer.or_else(|| float().map(Literal::Float)).ok_or_else(|| {
            self.at = start;
            self.error("a finite number")
        })
    }

    fn word(&mut self) -> Result<Literal, SyntaxError> {
        let start = self.at;
        match self.take_while(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '.')) {
            "None" => Ok(Literal::None),
            "True" => Ok(Literal::Bool(true)),
            "False" => Ok(Literal::Bool(false)),
            _ => {
                self.at = start;
                Err(self.error("a number, None, True, False, a string, a list or a dict"))
            }
        }
    }

    fn string(&mut self, quote: char) -> Result<String, SyntaxError> {
        self.at += quote.len_utf8();
        let mut value = String::new();
        loop {
            value.push_str(self.take_while(|c| c != quote && c != '\\'));
            if self.rest().starts_with(quote) {
                self.at += quote.len_utf8();
                return Ok(value);
            }
            value.push(self.escape()?);
        }
    }

    /// One escape of the kinds that Python's `repr` writes.
    fn escape(&mut self) -> Result<char, SyntaxError> {
        let expected = "a closing quote";
        let mut chars = self.rest().chars();
        let (Some('\\'), Some(kind)) = (chars.next(), chars.next()) else {
            self.at = self.text.len();
            return Err(self.error(expected));
        };
        let hex_digits = match kind {
            '\\' | '\'' | '"' => {
                self.at += 2;
                return Ok(kind);
            }
            'n' | 'r' | 't' => {
                self.at += 2;
                return Ok(match kind {
                    'n' => '\n',
                    'r' => '\r',
                    _ => '\t',
                });
            }
            'x' => 2,
            'u' => 4,
            'U' => 8,
            _ => return Err(self.error("an escape of Python's repr")),
        };
        let digits = self.rest().get(2..2 + hex_digits);
        let code = digits.filter(|digits| digits.bytes().all(|b| b.is_ascii_hexdigit()));
        let code = code.and_then(|digits| u32::from_str_radix(digits, 16).ok());
        let decoded = code.and_then(char::from_u32);
        let decoded = decoded.ok_or_else(|| self.error("a character code"))?;
        self.at += 2 + hex_digits;
        Ok(decoded)
    }
}
