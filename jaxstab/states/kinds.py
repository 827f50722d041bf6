"""The kinds of events along a branch of equilibria, and the reasons why it is not followed on."""

from jaxstab.core.enumeration import Enumeration, member


class KINDS(Enumeration):
    """The events on a branch, at which a stable branch ends or the load turns back.

    Example:
        >>> js.results.KINDS["release"].partition(":")[0]
        'release'
    """

    fold = member("the smallest eigenvalue on the free points vanishes")
    release = member("the reaction of a contact point vanishes, and opening lowers the energy")
    touch = member("a free point comes into contact, or separated surfaces do")
    bifurcation = member(
        "another branch crosses: an eigenvalue whose mode the load does not drive vanishes, or "
        "changes its sign where equal points detach or touch together"
    )
    uncertain = member("the branch ends, by an event of unknown kind")
    yielding = member("a contact point reaches the hardness, and yielding lowers the energy")


class ENDS(Enumeration):
    """The places where a continuation ends.

    Example:
        >>> js.results.ENDS["loop"].partition(":")[0]
        'loop'
    """

    load = member("at the second load")
    loop = member("at a state that it has passed before: it is a closed loop")
    states = member("at the requested number of states")
    full_contact = member("in full contact, where a load that prescribes the gap leads nowhere")
    uncertain = member("where even the shortest steps do not tell one branch from another")
    lost = member("where no next state was found")
    separated = member("where surfaces separate without end: hardly any attraction is left")
