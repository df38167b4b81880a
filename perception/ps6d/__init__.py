"""The PS6D network: cloud, point hierarchy, network, loss, voting, weights."""
