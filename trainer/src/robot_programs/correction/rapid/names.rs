//! RAPID's data by name: which of them a name means where it stands.

use std::collections::HashMap;

/// Data that a statement may change.
pub struct Change {
    /// Name in lower case; `None` for all data.
    pub name: Option<String>,
    /// Whether it may be data of any module and routine, as it is named in a string.
    pub is_anywhere: bool,
    /// Whether the change is in the files; otherwise it may be.
    pub is_certain: bool,
}

impl Change {
    /// Creates a change of the data to which a name refers where it stands.
    pub fn of(name: String, is_certain: bool) -> Self {
        Self {
            name: Some(name),
            is_anywhere: false,
            is_certain,
        }
    }
}

/// Data of one name.
#[derive(Clone, Debug)]
struct Named<T> {
    file: usize,
    routine: usize,
    is_local: bool,
    value: T,
}

/// Data by module file, routine and name. Data of a routine hide those of its module, which hide those of other modules;
/// local ones are seen in their own module alone.
#[derive(Clone, Debug)]
pub struct Names<T>(HashMap<String, Vec<Named<T>>>);

impl<T> Default for Names<T> {
    fn default() -> Self {
        Self(HashMap::new())
    }
}

impl<T> Names<T> {
    /// Adds data of a file and routine; routine 0 is the module.
    pub fn add(&mut self, name: &str, file: usize, routine: usize, is_local: bool, value: T) {
        self.0.entry(name.to_owned()).or_default().push(Named {
            file,
            routine,
            is_local,
            value,
        });
    }

    /// Returns the file of the data to which a name refers.
    pub fn file_of(&self, name: &str, file: usize, routine: usize) -> Option<usize> {
        let (index, _) = self.find_with_index(name, file, routine)?;
        Some(self.0[name][index].file)
    }

    /// Returns the data of a name that all modules see, each with its file.
    pub fn seen(&self, name: &str) -> impl Iterator<Item = (usize, &T)> {
        let all = self.0.get(name).into_iter().flatten();
        all.filter(|named| named.routine == 0 && !named.is_local)
            .map(|named| (named.file, &named.value))
    }

    /// Returns the data that a statement in a routine of a file changes: names, and indices among the data of the name.
    pub fn changed(&self, change: &Change, file: usize, routine: usize) -> Vec<(String, usize)> {
        let names = match &change.name {
            Some(name) => vec![name],
            None => {
                let mut names: Vec<&String> = self.0.keys().collect();
                names.sort();
                names
            }
        };
        let mut out = Vec::new();
        for name in names {
            let found = self.find_with_index(name, file, routine);
            let all = 0..self.0.get(name).map_or(0, Vec::len);
            let is_it = |index: &usize| {
                change.is_anywhere || found.is_some_and(|(found, _)| found == *index)
            };
            out.extend(all.filter(is_it).map(|index| (name.clone(), index)));
        }
        out
    }

    /// Returns data by their index among the data of their name.
    pub fn at(&self, name: &str, index: usize) -> Option<&T> {
        Some(&self.0.get(name)?.get(index)?.value)
    }

    /// Returns the same, to be changed.
    pub fn at_mut(&mut self, name: &str, index: usize) -> Option<&mut T> {
        Some(&mut self.0.get_mut(name)?.get_mut(index)?.value)
    }

    /// Returns the data to which a name refers in a routine of a file.
    pub fn find(&self, name: &str, file: usize, routine: usize) -> Option<&T> {
        self.find_with_index(name, file, routine).map(|(_, v)| v)
    }

    /// Returns the same, and its index among the data of its name.
    pub fn find_with_index(&self, name: &str, file: usize, routine: usize) -> Option<(usize, &T)> {
        let all = self.0.get(name)?;
        let in_file = |r: usize| all.iter().position(|n| n.file == file && n.routine == r);
        let others = || all.iter().position(|n| n.routine == 0 && !n.is_local);
        let index = in_file(routine).or_else(|| in_file(0)).or_else(others)?;
        all.get(index).map(|named| (index, &named.value))
    }
}
