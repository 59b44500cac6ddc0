//! KRL's data by name: each module has its own, in its source and its data list, and sees the global ones of other modules.

use std::collections::HashMap;

use crate::robot_programs::correction::source::Source;

/// Data of one name.
struct Named<T> {
    module: String,
    is_global: bool,
    value: T,
}

/// Data by module and name.
pub struct Names<T> {
    /// Module of each file.
    modules: Vec<String>,
    all: HashMap<String, Vec<Named<T>>>,
}

impl<T> Names<T> {
    /// Creates a list without data of files.
    pub fn new(sources: &[Source]) -> Self {
        let module = |source: &Source| {
            let path = source.path.with_extension("");
            path.display().to_string().to_ascii_lowercase()
        };
        Self {
            modules: sources.iter().map(module).collect(),
            all: HashMap::new(),
        }
    }

    /// Adds data of a file. What a module declares twice has the last value.
    pub fn add(&mut self, name: String, file: usize, is_global: bool, value: T) {
        let module = self.modules[file].clone();
        let all = self.all.entry(name).or_default();
        all.retain(|named| named.module != module);
        all.push(Named {
            module,
            is_global,
            value,
        });
    }

    /// Returns the data to which a name refers in a file.
    pub fn find(&self, name: &str, file: usize) -> Option<&T> {
        let index = self.index(name, file)?;
        self.all.get(name)?.get(index).map(|named| &named.value)
    }

    /// Returns the data to which a name refers in a file, to be changed.
    pub fn find_mut(&mut self, name: &str, file: usize) -> Option<&mut T> {
        let index = self.index(name, file)?;
        let named = self.all.get_mut(name)?.get_mut(index)?;
        Some(&mut named.value)
    }

    /// Returns the names of all known elements of an array.
    pub fn elements(&self, array: &str) -> Vec<String> {
        let start = format!("{array}[");
        let names = self.all.keys().filter(|name| name.starts_with(&start));
        names.cloned().collect()
    }

    /// Returns the index of the data of the file's own module, or of the only ones of other modules.
    fn index(&self, name: &str, file: usize) -> Option<usize> {
        let all = self.all.get(name)?;
        let only = |is_it: &dyn Fn(&Named<T>) -> bool| {
            let mut found = (0..all.len()).filter(|index| is_it(&all[*index]));
            found.next().filter(|_| found.next().is_none())
        };
        only(&|named| named.module == self.modules[file])
            .or_else(|| only(&|named| named.is_global))
            .or_else(|| only(&|_| true))
    }
}
