//! The modules of a crate: what each defines and imports, and in which file a path ends.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::tokens::{Kind, Token, sources, tokens, without_tests};

#[derive(Default)]
struct Module {
    file: usize,
    parent: Option<usize>,
    children: BTreeMap<String, usize>,
    items: BTreeSet<String>,
    /// Name and path of every import, including re-exports.
    uses: Vec<(String, Vec<String>)>,
    globs: Vec<Vec<String>>,
}

/// A use: one file names something that another file defines.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Arrow {
    pub from: String,
    pub to: String,
    /// Line and path of the use.
    pub line: usize,
    pub path: String,
}

impl std::fmt::Display for Arrow {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            from,
            to,
            line,
            path,
        } = self;
        write!(f, "{from}:{line} uses {to}: {path}")
    }
}

/// A crate as read from its sources.
#[derive(Default)]
pub struct Crate {
    pub files: Vec<String>,
    pub arrows: Vec<Arrow>,
    /// Other crates that it names, with file and line.
    pub crates: BTreeSet<(String, String)>,
    /// Paths that begin in the crate but cannot be resolved.
    pub lost: Vec<String>,
    modules: Vec<Module>,
    macros: BTreeMap<String, usize>,
    name: String,
}

enum Named {
    Module(usize),
    Item(usize),
}

impl Crate {
    /// Reads a folder of sources.
    pub fn read(name: &str, folder: &Path) -> Self {
        let texts: Vec<(String, String)> = sources(folder)
            .into_iter()
            .map(|path| {
                let inside = path.strip_prefix(folder).unwrap().to_str().unwrap();
                (inside.to_owned(), std::fs::read_to_string(&path).unwrap())
            })
            .collect();
        Self::of(name, &texts)
    }

    /// Reads source texts with their paths.
    pub fn of(name: &str, texts: &[(impl AsRef<str>, impl AsRef<str>)]) -> Self {
        let mut this = Self {
            name: name.replace('-', "_"),
            ..Self::default()
        };
        this.modules.push(Module::default());
        let mut read: Vec<_> = texts
            .iter()
            .map(|(path, text)| {
                let (tokens, tests) = without_tests(&tokens(text.as_ref()));
                (names(path.as_ref()), path.as_ref(), tokens, tests)
            })
            .collect();
        read.sort_by_key(|(names, ..)| names.len());
        let tests: Vec<Vec<String>> = read
            .iter()
            .flat_map(|(names, _, _, tests)| {
                tests
                    .iter()
                    .map(|test| [names.as_slice(), std::slice::from_ref(test)].concat())
            })
            .collect();
        read.retain(|(names, ..)| !tests.iter().any(|test| names.starts_with(test)));
        let mut at = Vec::new();
        for (names, path, tokens, _) in &read {
            let file = this.files.len();
            this.files.push((*path).to_owned());
            let module = names
                .iter()
                .fold(0, |parent, name| this.child(parent, name, file));
            this.modules[module].file = file;
            this.define(module, file, tokens);
            at.push(module);
        }
        for ((_, _, tokens, _), module) in read.iter().zip(at) {
            this.follow(module, tokens);
        }
        this.arrows.sort();
        this.arrows
            .dedup_by(|a, b| (&a.from, &a.to) == (&b.from, &b.to));
        this
    }

    fn child(&mut self, parent: usize, name: &str, file: usize) -> usize {
        let new = self.modules.len();
        let child = *self.modules[parent]
            .children
            .entry(name.to_owned())
            .or_insert(new);
        if child == new {
            self.modules.push(Module {
                file,
                parent: Some(parent),
                ..Module::default()
            });
        }
        child
    }

    /// Records what a module defines and imports.
    fn define(&mut self, module: usize, file: usize, tokens: &[Token]) {
        let mut depth = 0;
        let mut at = 0;
        while at < tokens.len() {
            let word = |n: usize| tokens.get(at + n).map_or("", |t| t.text.as_str());
            match tokens[at].text.as_str() {
                _ if !matches!(tokens[at].kind, Kind::Word | Kind::Symbol) => {}
                "{" => depth += 1,
                "}" => depth -= 1,
                "use" => {
                    let end = at + tokens[at..].iter().position(|t| t.is(";")).unwrap();
                    let mut found = Vec::new();
                    tree(&tokens[at + 1..end], &[], &mut found);
                    for (name, path) in found {
                        match name.as_str() {
                            "*" => self.modules[module].globs.push(path),
                            _ => self.modules[module].uses.push((name, path)),
                        }
                    }
                    at = end;
                }
                "macro_rules" => {
                    self.macros.insert(word(2).to_owned(), file);
                    // A macro defines its items where it is called, which is in this file.
                    let body = &tokens[at + 3..at + 3 + braces(&tokens[at + 3..])];
                    let traits = body.windows(2).filter(|pair| pair[0].is("trait"));
                    self.modules[module]
                        .items
                        .extend(traits.map(|pair| pair[1].text.clone()));
                }
                "mod" if depth == 0 && word(2) == "{" => {
                    let end = at + 2 + braces(&tokens[at + 2..]);
                    let child = self.child(module, word(1), file);
                    self.define(child, file, &tokens[at + 3..end]);
                    at = end;
                }
                "fn" | "struct" | "enum" | "trait" | "type" | "const" | "static" | "union"
                    if depth == 0 && word(1) != "fn" =>
                {
                    let name = if word(1) == "mut" { word(2) } else { word(1) };
                    let name = name.to_owned();
                    self.modules[module].items.insert(name);
                }
                _ => {}
            }
            at += 1;
        }
    }

    /// Records to which files the paths in a file lead.
    fn follow(&mut self, module: usize, tokens: &[Token]) {
        let mut at = 0;
        while at < tokens.len() {
            let token = &tokens[at];
            if token.is("use") {
                let is_public = at > 0 && (tokens[at - 1].is("pub") || tokens[at - 1].is(")"));
                let end = at + tokens[at..].iter().position(|t| t.is(";")).unwrap();
                let mut found = Vec::new();
                tree(&tokens[at + 1..end], &[], &mut found);
                for (_, path) in found {
                    // A parent may re-export what its children define.
                    if !is_public {
                        self.arrow(module, &path, token.line);
                    } else if path[0].starts_with("poegp_") {
                        self.arrow(module, &path[..1], token.line);
                    }
                }
                at = end;
            } else if token.is("mod") && tokens.get(at + 2).is_some_and(|t| t.is("{")) {
                let end = at + 2 + braces(&tokens[at + 2..]);
                let child = self.modules[module].children[&tokens[at + 1].text];
                self.follow(child, &tokens[at + 3..end]);
                at = end;
            } else if token.kind == Kind::Word && (at == 0 || !tokens[at - 1].is("::")) {
                let mut path = vec![token.text.clone()];
                while at + 2 < tokens.len()
                    && tokens[at + 1].is("::")
                    && tokens[at + 2].kind == Kind::Word
                {
                    path.push(tokens[at + 2].text.clone());
                    at += 2;
                }
                let is_glob = path.len() == 1 && !self.modules[module].items.contains(&path[0]);
                if path.len() > 1 {
                    self.arrow(module, &path, token.line);
                } else if is_glob {
                    for glob in self.modules[module].globs.clone() {
                        self.arrow_if(module, &[glob, path.clone()].concat(), token.line);
                    }
                }
            }
            at += 1;
        }
    }

    fn arrow_if(&mut self, module: usize, path: &[String], line: usize) {
        let lost = self.lost.len();
        self.arrow(module, path, line);
        self.lost.truncate(lost);
    }

    fn arrow(&mut self, module: usize, path: &[String], line: usize) {
        let from = self.files[self.modules[module].file].clone();
        if path[0].starts_with("poegp_") && path[0] != self.name {
            self.crates
                .insert((path[0].clone(), format!("{from}:{line}")));
        }
        match self.resolve(module, path, 0) {
            Some(Named::Item(file)) if self.files[file] != from => self.arrows.push(Arrow {
                from,
                to: self.files[file].clone(),
                line,
                path: path.join("::"),
            }),
            None if matches!(path[0].as_str(), "crate" | "super" | "self") => {
                self.lost
                    .push(format!("{from}:{line}: {}", path.join("::")));
            }
            _ => {}
        }
    }

    fn resolve(&self, module: usize, path: &[String], depth: usize) -> Option<Named> {
        let (first, mut rest) = path.split_first()?;
        let mut at = match first.as_str() {
            "crate" => 0,
            "self" => module,
            "super" => self.modules[module].parent?,
            name if name == self.name => 0,
            name => match self.lookup(module, name, depth)? {
                Named::Module(module) => module,
                item => return Some(item),
            },
        };
        while let Some((name, more)) = rest.split_first() {
            rest = more;
            at = match name.as_str() {
                "super" => self.modules[at].parent?,
                "self" => at,
                name => match self.lookup(at, name, depth)? {
                    Named::Module(module) => module,
                    item => return Some(item),
                },
            };
        }
        Some(Named::Module(at))
    }

    /// Resolves a name in a module.
    fn lookup(&self, module: usize, name: &str, depth: usize) -> Option<Named> {
        let this = &self.modules[module];
        if let Some(child) = this.children.get(name) {
            return Some(Named::Module(*child));
        }
        if this.items.contains(name) {
            return Some(Named::Item(this.file));
        }
        if module == 0
            && let Some(file) = self.macros.get(name)
        {
            return Some(Named::Item(*file));
        }
        if depth > 8 {
            return None;
        }
        let imported = this
            .uses
            .iter()
            .filter(|(shown, path)| shown == name && path.as_slice() != [name]);
        let globbed = this
            .globs
            .iter()
            .map(|glob| [glob.as_slice(), &[name.to_owned()]].concat());
        let mut paths = imported.map(|(_, path)| path.clone()).chain(globbed);
        paths.find_map(|path| self.resolve(module, &path, depth + 1))
    }

    /// Groups of files that reach each other, sorted; each group contains one or more cycles.
    pub fn circles(&self) -> Vec<Vec<String>> {
        let reach = |from: &String| {
            let mut seen = BTreeSet::new();
            let mut open = vec![from.as_str()];
            while let Some(file) = open.pop() {
                let next = self.arrows.iter().filter(|a| a.from == file);
                open.extend(next.map(|a| a.to.as_str()).filter(|to| seen.insert(*to)));
            }
            seen.into_iter()
                .map(str::to_owned)
                .collect::<BTreeSet<String>>()
        };
        let reached: BTreeMap<&str, _> =
            self.files.iter().map(|f| (f.as_str(), reach(f))).collect();
        let mut groups: Vec<Vec<String>> = Vec::new();
        for (file, seen) in &reached {
            let group = seen
                .iter()
                .filter(|to| reached[to.as_str()].contains(*file));
            let group: Vec<String> = group.cloned().collect();
            if !group.is_empty() && !groups.contains(&group) {
                groups.push(group);
            }
        }
        groups
    }
}

/// Returns the module path of a file: `a/b.rs` and `a/b/mod.rs` are `a::b`, and the root is empty.
fn names(path: &str) -> Vec<String> {
    let path = path.trim_end_matches(".rs");
    let names = path
        .split('/')
        .filter(|name| !matches!(*name, "mod" | "lib" | "main"));
    names.map(str::to_owned).collect()
}

/// Returns the index of the closing brace of the block that begins `tokens`.
fn braces(tokens: &[Token]) -> usize {
    let mut depth = 0;
    for (i, token) in tokens.iter().enumerate() {
        depth += i32::from(token.is("{")) - i32::from(token.is("}"));
        if depth == 0 {
            return i;
        }
    }
    tokens.len()
}

/// Collects the names and paths of the tree of a `use`; a glob has the name `*`.
fn tree(tokens: &[Token], before: &[String], out: &mut Vec<(String, Vec<String>)>) {
    let mut path = before.to_vec();
    for (i, token) in tokens.iter().enumerate() {
        match token.text.as_str() {
            "{" => {
                let end = i + braces(&tokens[i..]);
                let (mut depth, mut begin) = (0, i + 1);
                for k in i + 1..=end {
                    if depth == 0 && (tokens[k].is(",") || k == end) {
                        if begin < k {
                            tree(&tokens[begin..k], &path, out);
                        }
                        begin = k + 1;
                    }
                    depth += i32::from(tokens[k].is("{")) - i32::from(tokens[k].is("}"));
                }
                return;
            }
            "*" => return out.push(("*".to_owned(), path)),
            "as" => return out.push((tokens[i + 1].text.clone(), path)),
            "self" if !path.is_empty() => {}
            _ if token.kind == Kind::Word => path.push(token.text.clone()),
            _ => {}
        }
    }
    out.push((path.last().unwrap().clone(), path));
}
