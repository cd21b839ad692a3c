"""prototype"""
from __future__ import annotations
import time
import numpy as np
from excitant.design.criterion import information
from excitant.design.feasible import random_trajectory
from excitant.design.mixture import best_mixture
from excitant.design.moments import Band, candidates
from excitant.design.states import state_space
from excitant.robots import Motion
from excitant.robots.torque import torque

class Problem:
    def __init__(s, robot, duration, harmonics, columns='inertial', bernstein=True):
        s.robot=robot; s.info=information(robot,columns)
        s.omega=2*np.pi/duration; s.H=harmonics
        s.top=s.omega*harmonics if bernstein else np.inf
        s.space=state_space(robot,s.top)
        s.tests=None; s.band=None
        s.D=None
        full=np.zeros(s.info.base.regrouping.shape[1]); full[:10*robot.nv]=robot.phi
        s.beta=s.info.base.regrouping@full
        odd=np.zeros(len(s.info.base),bool)
        names=[s.info.base.names[c] for c in s.info.base.columns]
        odd=np.array([n.endswith(('.Fv','.Fc')) for n in names])
        s.groups=[np.flatnonzero(~odd)]+([np.flatnonzero(odd)] if odd.any() else [])
    def mot(s,x): return Motion(np.arange(len(x[0]),dtype=float),*x)
    def Y(s,x): return s.info.observation(s.mot(x))
    def tau(s,x): return torque(s.robot,s.mot(x))
    def blocks(s,Y):
        return [np.swapaxes(Y[:,:,g],1,2)@Y[:,:,g] for g in s.groups]
    def g(s,x,dual):
        """g, trace, penalty"""
        D,y,B=dual
        Y=s.Y(x); val=np.zeros(len(Y))
        for g,d in zip(s.groups,D):
            Z=Y[:,:,g]; val+=np.einsum('nij,nij->n',Z@d,Z)
        tr=(Y**2).sum((1,2))
        if s.tests is not None: val+=s.tests.rates(*x)@y
        if s.band is not None:
            for F,v in zip(s.band.form(B),(x[0]-s.space.middle,x[1],x[2])): val+=np.einsum('ni,ij,nj->n',v,F,v)
        over=np.maximum(np.abs(s.tau(x))/s.robot.limits.torque-1,0)
        return val,tr,(over**2).sum(1)
    def value(s,u,dual,rho):
        v,tr,o=s.g(s.space.states(u),dual)
        return v/tr-rho*o
    def grad(s,u,dual,rho):
        D,y,B=dual; x=s.space.states(u)
        L=s.info.linearise(s.mot(x)); Y=L.Y
        YD=np.zeros_like(Y); val=np.zeros(len(Y))
        for g,d in zip(s.groups,D):
            Z=Y[:,:,g]@d; YD[:,:,g]=Z; val+=np.einsum('nij,nij->n',Z,Y[:,:,g])
        tr=(Y**2).sum((1,2))
        gr=[]; add=[np.zeros_like(x[0]) for _ in range(3)]
        if s.tests is not None:
            v,*add=s.tests.gradient(*x,y); val+=v
        if s.band is not None:
            for k,(F,v) in enumerate(zip(s.band.form(B),(x[0]-s.space.middle,x[1],x[2]))):
                val+=np.einsum('ni,ij,nj->n',v,F,v); add[k]=add[k]+2*v@F
        ratio=val/tr
        G=(YD-ratio[:,None,None]*Y)*2
        tau=s.tau(x); lim=s.robot.limits.torque
        pen=2*np.maximum(np.abs(tau)/lim-1,0)*np.sign(tau)/lim
        T=G/tr[:,None,None]-rho*pen[:,:,None]*s.beta
        for k,by in enumerate((L.by_q,L.by_dq,L.by_ddq)):
            gr.append(np.einsum('jnir,nir->nj',by,T,optimize=True)+add[k]/tr[:,None])
        return s.space.pull(u,*gr)
    def ascend(s,u,dual,rho,steps=20):
        v=s.value(u,dual,rho)
        L=0.3*np.ones(len(u))
        for it in range(steps):
            d=s.grad(u,dual,rho)
            # free components only
            d=np.where((np.abs(u)>=1)&(d*u>0),0,d)
            nd=np.abs(d).max(1,keepdims=True); d=d/np.maximum(nd,1e-300)
            best=u.copy(); bv=v.copy(); bl=L*0.2
            for f in (0.05,0.25,1.0,4.0):
                w=np.clip(u+(f*L)[:,None]*d,-1,1)
                wv=s.value(w,dual,rho); up=wv>bv
                best[up]=w[up]; bv[up]=wv[up]; bl[up]=(f*L)[up]
            u,v,L=best,bv,np.clip(bl,1e-5,2)
        return u,v

def shrink(s,x):
    """Scale time until torque holds."""
    lim=s.robot.limits.torque*(1+1e-9)
    q,dq,ddq=x
    t=(np.abs(s.tau(x))/lim).max(1); keep=t<=1
    S=np.ones(len(q))
    for f in np.linspace(0.99,0,25):
        todo=~keep
        if not todo.any(): break
        xx=(q[todo],f*dq[todo],f*f*ddq[todo])
        ok=(np.abs(s.tau(xx))/lim).max(1)<=1
        i=np.flatnonzero(todo)[ok]; S[i]=f; keep[i]=True
    return (q[keep],S[keep,None]*dq[keep],(S**2)[keep,None]*ddq[keep])

def run(prob,level=None,band=True,limit=80,seed=0,pool=(),ntraj=8,per=40,starts=240,maxrows=150,verbose=True,rho=1e3,tol=1e-4,mu=0.1,allrows=True):
    t0=time.process_time(); rng=np.random.default_rng(seed); s=prob
    X=[random_trajectory(s.robot,rng,2*np.pi/s.omega,s.H).at(np.arange(per)/per*2*np.pi/s.omega) for _ in range(ntraj)]+list(pool)
    x=tuple(np.concatenate([getattr(m,k) for m in X]) for k in ('q','dq','ddq'))
    cand=candidates(s.space.middle,s.space.half,s.space.speed,**level) if level is not None else None
    scale=None
    if cand is not None:
        xr=s.space.states(rng.uniform(-1,1,(2000,3*s.robot.nv)))
        scale=np.sqrt((cand.rates(*xr)**2).mean(0)); trr=(s.Y(xr)**2).sum((1,2)).mean()
        chosen=np.arange(len(cand)) if allrows else np.zeros(0,int)
    s.band=Band(s.omega,s.H) if band else None
    best=0; hist=[]
    it=0
    while time.process_time()-t0<limit:
        Y=s.Y(x); tr=(Y**2).sum((1,2))
        Ms=[b/tr[:,None,None] for b in s.blocks(Y)]
        cones=[]
        if band:
            cones=[n/tr[:,None,None] for n in s.band.matrices(x[0]-s.space.middle,x[1],x[2])]
            cs=[np.abs(np.trace(c,axis1=1,axis2=2)).mean() for c in cones]
            cones=[c/k for c,k in zip(cones,cs)]
        if cand is not None:
            A=cand.rates(*x)/scale*(trr/tr)[:,None]
            s.tests=cand[chosen] if len(chosen) else None
            rows=A[:,chosen]
        else: rows=np.zeros((len(tr),0)); s.tests=None
        t1=time.process_time()
        sol=best_mixture(Ms,rows,cones,bound=mu,tolerance=1e-2 if it<6 else 1e-3); tm=time.process_time()-t1
        y=sol.y/scale[chosen]*trr if cand is not None else sol.y
        B=[b/k for b,k in zip(sol.B,cs)] if band else []
        dual=([p-q for p,q in zip(sol.P,sol.Q)],y,B)
        # pricing
        t1=time.process_time()
        w=sol.weights; top=np.argsort(-w)[:starts//2]
        u0=s.space.cube(*(a[top] for a in x))
        ur=rng.uniform(-1,1,(3000,3*s.robot.nv)); ur[:,2*s.robot.nv:]=np.where(rng.random((3000,s.robot.nv))<.5,np.sign(ur[:,2*s.robot.nv:]),ur[:,2*s.robot.nv:])
        vr=s.value(ur,dual,rho); u0=np.concatenate([u0,ur[np.argsort(-vr)[:starts//2]]])
        u,v=s.ascend(u0,dual,rho,steps=12)
        xn=shrink(s,s.space.states(u)); gn,tn,_=s.g(xn,dual)
        eps=max((gn/tn).max(),0); tp=time.process_time()-t1
        trP=sum(np.trace(p) for p in sol.P); p=len(s.info.base)
        val=np.sqrt(trP/(1+p*eps)); best=max(best,val)
        newrows=0
        if cand is not None:
            viol=np.abs(w@A)/ (np.sqrt((w@(A**2))*w.sum())+1e-300)
            viol[chosen]=0
            if len(chosen)<maxrows:
                add=np.argsort(-viol)[:min(25,maxrows-len(chosen))]; add=add[viol[add]>1e-2]; chosen=np.concatenate([chosen,add]); newrows=len(add)
        if verbose: print(f'{it} t={time.process_time()-t0:.1f} N={len(tr)} rows={rows.shape[1]} master={np.sqrt(trP):.4f} eps={eps:.2e} val={val:.4f} best={best:.4f} ipm {sol.iterations} {sol.gap:.1e} {tm:.2f}s price {tp:.2f}s supp={(w>1e-3*w.max()).sum()} rkP={[int((np.linalg.eigvalsh(q)>1e-3*np.trace(q)).sum()) for q in sol.P]} rkQ={[int((np.linalg.eigvalsh(q)>1e-3).sum()) for q in sol.Q]} maxy={np.abs(sol.y).max(initial=0):.2f}',flush=True)
        hist.append((np.sqrt(trP),val))
        if eps<tol and not newrows: break
        keep=np.ones(len(tr),bool); nk=int(2*(w>1e-3*w.max()).sum())+80
        if len(tr)>nk:
            # drop most negative reduced cost
            gx,tx,_=s.g(x,dual); keep[np.argsort(gx/tx)[:len(tr)-nk]]=False
        pos=gn/tn>0.02*eps
        x=tuple(np.concatenate([a[keep],b[pos]]) for a,b in zip(x,xn))
        it+=1
    return best,hist,x,dual
