"""JUDGE and IDENTIFY: trajectory error of bags, parameter estimates.

    recorded = read_drive(bag)                                # one pass over the bag
    judge_drive(recorded).te                                  # trajectory error
    identify([measured_drive(recorded, vehicle)], vehicle)    # unknown parameters

`drives` makes drives of bags and of simulations, `judging` compares them with their reference,
`estimation` holds the steps of an `identification`.
"""

from tricycle_core.renamed import install

install()
