"""The events along a branch of equilibria, and why it is followed no more."""

from jaxstab.core.enumeration import Enumeration, member


class KINDS(Enumeration):
    """Why a stable branch ends, where the load turns back, and why a branch is followed no more."""

    fold = member("the smallest eigenvalue on the free points vanishes")
    release = member("a contact point lets go, and the energy falls as it opens")
    touch = member("a free point comes into contact, or surfaces that a pull had taken apart do")
    load = member("at the second load")
    loop = member("at a state that it has passed before: it is a closed loop")
    states = member("at the number of states that was asked for")
    full_contact = member("in full contact, from which a load that holds the gap leads nowhere")
    uncertain = member("where steps of the least length do not tell one branch from another")
    lost = member("where no next state was found")
    separated = member("where surfaces go apart without end: next to no attraction is left")
