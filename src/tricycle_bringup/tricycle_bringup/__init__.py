"""Launch files, configuration, robot description and Foxglove layout."""

from tricycle_core.renamed import install

install()
