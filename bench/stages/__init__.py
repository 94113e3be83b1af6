"""One measurement for each stage and its peers: `measure(quick)` of a module gives its `Result`.

`scenes` makes the parts, requests and shaken plates that they share.
"""
